"""Runs that several benchmarks share: experts, norms learned from them, agents aligned by preferences.

Each keeps its files in its folder as the command ``moral`` does, and goes on from there if it was killed.
"""

from benchmarks.stages.aligned import Aligned, PrimaryReturn
from benchmarks.stages.coverage import Weighted
from benchmarks.stages.covered import Asked, Covered
from benchmarks.stages.norms import LearnedNorm, TrainedExpert
from benchmarks.stages.preferences import FromPreferences

__all__ = [
    "Aligned",
    "Asked",
    "Covered",
    "FromPreferences",
    "LearnedNorm",
    "PrimaryReturn",
    "TrainedExpert",
    "Weighted",
]

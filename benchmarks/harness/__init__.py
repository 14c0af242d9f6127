"""What the benchmarks have in common: runs that are done once, the sweeps over them, checks and the report.

A *run* is a frozen dataclass that says all its result depends on and how it is carried out. A *benchmark*,
one per figure or table, says which runs it takes, judges their results and draws them. Runs that several
benchmarks share are done once.
"""

from benchmarks.harness.benchmark import Benchmark, Check, Profile, Results, Verdict
from benchmarks.harness.run import Run, Workspace
from benchmarks.harness.store import Store

__all__ = ["Benchmark", "Check", "Profile", "Results", "Run", "Store", "Verdict", "Workspace"]

"""From nothing to an aligned agent, one function per stage.

``expert`` trains a policy to learn from, ``demonstrate`` records it, ``airl`` learns a reward from that,
``moral`` trains under that reward and the world's own, balanced by a teacher's preferences, and ``evaluate``
measures a policy beside the exact optimum. Each leaves its results in files, from which the next goes on.

``cover`` and ``align`` do what ``moral`` does in two parts: a policy for all weights, trained once, and the
queries of any number of teachers.
"""

from moral_algorithms.pipeline.alignment import MoralRun, begin_moral, begin_replay, moral, read_moral_run
from moral_algorithms.pipeline.baseline import DRLHPRun, drlhp, drlhp_preset, read_drlhp_run
from moral_algorithms.pipeline.covering import AlignRun, CoverRun, align, cover, read_align_run, read_covered
from moral_algorithms.pipeline.imitation import airl, demonstrate, expert
from moral_algorithms.pipeline.measurement import Evaluation, evaluate, find_policy
from moral_algorithms.pipeline.presets import airl_config, expert_config, teacher_order
from moral_algorithms.pipeline.resuming import changes_since_start, how_to_resume, read_setting
from moral_algorithms.pipeline.reward_vector import (
    choose_world,
    component_names,
    normaliser_config,
    reward_components,
)
from moral_algorithms.pipeline.stage import Setting
from moral_algorithms.pipeline.teaching import TeacherConfig
from moral_algorithms.seeding import spawn_seeds

__all__ = [
    "AlignRun",
    "CoverRun",
    "DRLHPRun",
    "Evaluation",
    "MoralRun",
    "Setting",
    "TeacherConfig",
    "airl",
    "airl_config",
    "align",
    "begin_moral",
    "begin_replay",
    "changes_since_start",
    "choose_world",
    "component_names",
    "cover",
    "demonstrate",
    "drlhp",
    "drlhp_preset",
    "evaluate",
    "expert",
    "expert_config",
    "find_policy",
    "how_to_resume",
    "moral",
    "normaliser_config",
    "read_align_run",
    "read_covered",
    "read_drlhp_run",
    "read_moral_run",
    "read_setting",
    "reward_components",
    "spawn_seeds",
    "teacher_order",
]

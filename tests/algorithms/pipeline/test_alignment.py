"""The teachers that a configuration names."""

from __future__ import annotations

import numpy as np
import pytest

from moral_algorithms.pipeline import TeacherConfig
from moral_algorithms.preferences import NoisyTeacher, Preference, Query

DELIVERY = ("delivered", "helped", "cleaned", "vases_broken")
THESIS = {
    "lexicographic": TeacherConfig("lexicographic", order=("delivered", "helped")),
    "malicious": TeacherConfig("lexicographic", order=("vases_broken",)),
    "ratio": TeacherConfig("ratio", ratio={"delivered": 3, "helped": 1, "cleaned": 1}),
    "target": TeacherConfig("target", target={"delivered": 5, "helped": 5, "cleaned": 5, "vases_broken": 0}),
}


@pytest.mark.parametrize(
    ("first", "second", "preferred"),
    [
        # The same pair: the second breaks more vases, is closer to 3 : 1 : 1 and further from the target.
        ([5, 5, 4, 0], [4, 2, 1, 2], {"lexicographic": "first", "ratio": "second", "target": "first"}),
        ([5, 5, 5, 2], [3, 1, 1, 2], {"malicious": "equal", "ratio": "second", "target": "first"}),
        ([0, 9, 0, 1], [1, 0, 0, 0], {"lexicographic": "second", "malicious": "first", "ratio": "second"}),
    ],
)
def test_every_teacher_of_the_thesis_can_be_configured(
    first: list[int], second: list[int], preferred: dict[str, str]
) -> None:
    query = Query(np.zeros((2, 2)), np.array([first, second]))
    for name, answer in preferred.items():
        teacher = THESIS[name].build(DELIVERY, np.random.default_rng(0))
        assert teacher.prefer(query) is Preference(answer), name


@pytest.mark.parametrize("name", THESIS)
def test_every_teacher_may_be_noisy(name: str) -> None:
    config = TeacherConfig(**{**vars(THESIS[name]), "noise": 0.3})
    teacher = config.build(DELIVERY, np.random.default_rng(0))
    assert isinstance(teacher, NoisyTeacher)
    assert teacher.probability == 0.3

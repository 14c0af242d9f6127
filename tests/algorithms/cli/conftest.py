"""The results of the stages before MORAL, made once per process."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from tests.algorithms.cli.commands import AIRL, DEMONSTRATE, EXPERT, TRAIN, run


class Stages(NamedTuple):
    """Where they are."""

    expert: Path
    demonstrations: Path
    airl: Path
    moral: Path


@pytest.fixture(scope="session")
def stages(tmp_path_factory: pytest.TempPathFactory) -> Stages:
    folder = tmp_path_factory.mktemp("stages")
    made = Stages(*(folder / name for name in ("expert", "demonstrations.npz", "airl", "moral")))
    assert run(*EXPERT, "--out", made.expert) == 0
    assert run(*DEMONSTRATE, "--expert", made.expert, "--out", made.demonstrations) == 0
    assert run(*AIRL, "--demonstrations", made.demonstrations, "--out", made.airl) == 0
    assert run(*TRAIN, "--rewards", made.airl, "--out", made.moral) == 0
    return made

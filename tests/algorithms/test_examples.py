"""The files that the page about the library shows run, here with as little training as there can be."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from moral_algorithms.learners.airl import AIRLConfig
from moral_algorithms.learners.moral import MoralConfig
from moral_algorithms.networks.files import load_policy, load_reward
from moral_algorithms.preferences import Preference, Query
from tests.algorithms.tiny import ppo_config

DOCS = Path(__file__).parents[2] / "docs"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_example_is_shown_by_a_page() -> None:
    shown = set()
    for page in DOCS.glob("*.md"):
        shown |= set(re.findall(r"\{literalinclude\} examples/(\w+)\.py", page.read_text(encoding="utf-8")))
    assert shown == {path.stem for path in (DOCS / "examples").glob("*.py")}


@pytest.mark.parametrize(
    ("first", "second", "answer"),
    [
        ([10, 4], [9, 6], Preference.FIRST),
        ([70, 3], [0, 4], Preference.SECOND),
        ([5, 5], [5, 6], Preference.EQUAL),
    ],
)
def test_the_teacher_wants_what_it_says(first: list[int], second: list[int], answer: Preference) -> None:
    teacher = example("own_teacher").EnoughIsEnough()
    assert teacher.prefer(Query(np.zeros((2, 2)), np.array([first, second]))) == answer


def test_a_teacher_of_ones_own(tmp_path: Path) -> None:
    ppo = ppo_config(num_envs=8, rollout_steps=25, batch_size=200, epochs=1)
    config = MoralConfig(steps=1400, queries=2, candidates=20, samples=50, ppo=ppo)
    agent = example("own_teacher").main(tmp_path, config)
    assert agent.queries == 2
    assert load_policy(tmp_path / "policy.safetensors").world.name == "emergency"


def test_demonstrations_of_ones_own_and_what_is_learned_from_them_in_another_learner(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = AIRLConfig(
        steps=1600,
        discriminator_updates=2,
        discriminator_batch=64,
        normaliser_episodes=10,
        ppo=ppo_config(num_envs=32, rollout_steps=25, batch_size=400, epochs=1),
    )
    demonstrations = example("own_demonstrations")
    demonstrations.main(tmp_path, config)
    played = demonstrations.Demonstrations.load(tmp_path / "demonstrations.npz")
    # The way is short, and there it stays.
    assert played.objectives[:, 0].min() >= 60
    path = tmp_path / "reward.safetensors"
    assert load_reward(path).world.name == "emergency"
    model = example("learned_reward_in_sb3").main(path, steps=1280)
    assert model.num_timesteps >= 1280
    assert model.get_env().get_attr("weights")[0].tolist() == pytest.approx([0.8, 0.2])
    assert capsys.readouterr().out

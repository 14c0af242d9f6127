"""The reward that is fitted to preferences: its loss, its resamples and what it learns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from moral_algorithms.evaluation import RandomPolicy
from moral_algorithms.learners.clips import (
    AnsweredClips,
    Pairs,
    Recording,
    draw_pairs,
    play_again,
    play_untrained,
)
from moral_algorithms.learners.reward_model import (
    RewardModel,
    RewardModelConfig,
    disagreement,
    preference_loss,
)
from moral_algorithms.networks.rewards import ActionRewardEnsemble
from moral_algorithms.preferences import BradleyTerry, LexicographicTeacher, Preference, Query
from moral_envs.engine import Engine
from tests.algorithms.tiny import EMERGENCY

WORLD = EMERGENCY.build()
SHAPE = Engine(WORLD).observation_shape


def config(**changes: Any) -> RewardModelConfig:
    values: dict[str, Any] = {
        "architecture": "fast",
        "members": 2,
        "lapse": 0.1,
        "updates": 1,
        "initial_updates": 1,
        "batch_size": 16,
        "learning_rate": 1e-2,
        "weight_decay": 0.1,
    }
    return RewardModelConfig(**{**values, **changes})


def recorded(count: int = 64, seed: int = 0) -> Recording:
    return play_again(WORLD, play_untrained(RandomPolicy(9, np.random.default_rng(seed)), WORLD, count, seed))


def answered(recording: Recording, count: int, length: int = 4) -> AnsweredClips:
    """Pairs of clips, compared by people saved, then goal time."""
    teacher = LexicographicTeacher(("people_saved", "goal_time"), WORLD.objective_names)
    answers = AnsweredClips(SHAPE, length, count)
    pairs = draw_pairs(np.random.default_rng(1), recording, length, count)
    for index in range(len(pairs.starts)):
        objectives = pairs.objectives(index, recording.counters)
        preference = teacher.prefer(Query(np.zeros((2, 1)), objectives))
        answers.add(pairs.cut(index, recording.states), pairs.cut(index, recording.actions), preference)
    return answers


def model(answers: AnsweredClips, seed: int = 0, **changes: Any) -> RewardModel:
    torch.manual_seed(seed)
    settings = config(**changes)
    return RewardModel(
        ActionRewardEnsemble(SHAPE, 9, settings.architecture, settings.members), answers, settings, seed
    )


def parameters(reward: RewardModel, member: int) -> list[torch.Tensor]:
    return [p.detach().clone() for p in reward.network.members[member].parameters()]


@pytest.mark.parametrize("lapse", [0.0, 0.1, 0.9])
def test_the_loss_is_that_of_the_likelihood(lapse: float) -> None:
    differences = np.linspace(-6, 6, 13)
    likelihood = BradleyTerry(lapse=lapse)
    first, second = likelihood.log_probability(differences), likelihood.log_probability(-differences)
    for target, expected in ((1.0, -first), (0.0, -second), (0.5, -(first + second) / 2)):
        targets = torch.full((13,), target)
        losses = preference_loss(torch.from_numpy(differences), targets, lapse)
        np.testing.assert_allclose(losses.numpy(), expected, rtol=1e-6)


def test_a_hopeless_answer_moves_nothing_under_a_lapse_rate() -> None:
    for lapse, most in ((0.1, 1e-6), (0.0, 1.1)):
        difference = torch.tensor([30.0], requires_grad=True)
        preference_loss(difference, torch.zeros(1), lapse).sum().backward()  # type: ignore[no-untyped-call]
        assert difference.grad is not None
        assert abs(float(difference.grad)) < most
        assert (abs(float(difference.grad)) > 0.9) == (lapse == 0)


def test_it_learns_what_the_teacher_prefers() -> None:
    reward = model(answered(recorded(128), 500), lapse=0.0, learning_rate=3e-3)
    reward.train(300)
    others = recorded(64, seed=5)
    rewards = reward.predict(others).mean(axis=0)
    earned = np.diff(others.counters, axis=1)
    nothing = rewards[~earned.any(axis=2)].mean()
    assert rewards[earned[..., 1] > 0].mean() > nothing + 5 * rewards[~earned.any(axis=2)].std()
    # It has never seen these; a coin would be right half the time.
    pairs = draw_pairs(np.random.default_rng(2), others, 4, 300)
    saved = np.array([pairs.objectives(index, others.counters)[:, 1] for index in range(len(pairs.starts))])
    differs = saved[:, 0] != saved[:, 1]
    returns = pairs.sums(rewards)
    right = (returns[:, 0] > returns[:, 1]) == (saved[:, 0] > saved[:, 1])
    # Measured: 0.86 and 0.90.
    assert right[differs].mean() > 0.75
    assert reward.losses.keys() == {"training", "held_out"}
    # That nothing differs costs log 2 an answer.
    assert max(reward.losses.values()) < 0.6


def test_ties_alone_teach_that_nothing_differs() -> None:
    recording = recorded()
    answers = AnsweredClips(SHAPE, 4, 100)
    pairs = draw_pairs(np.random.default_rng(1), recording, 4, 100)
    for index in range(100):
        states, actions = pairs.cut(index, recording.states), pairs.cut(index, recording.actions)
        answers.add(states, actions, Preference.EQUAL)
    reward = model(answers)
    before = np.abs(np.diff(pairs.sums(reward.predict(recording)))).mean()
    reward.train(200)
    assert np.abs(np.diff(pairs.sums(reward.predict(recording)))).mean() < 0.2 * before


def test_without_answers_nothing_is_trained() -> None:
    reward = model(AnsweredClips(SHAPE, 4, 10))
    before = parameters(reward, 0)
    reward.train(5)
    assert all(torch.equal(*pair) for pair in zip(before, parameters(reward, 0), strict=True))
    assert reward.losses == {}


def test_each_member_has_its_own_answers() -> None:
    reward = model(answered(recorded(), 200), members=3)
    reward.train(1)
    drawn = reward._multiplicities
    assert drawn.shape == (200, 3)
    # Poisson with mean 1: one answer in e is never seen.
    assert np.abs(drawn.mean(axis=0) - 1).max() < 0.3
    assert np.abs((drawn == 0).mean(axis=0) - np.exp(-1)).max() < 0.12
    assert not (drawn[:, 0] == drawn[:, 1]).all()
    reward.train(1)
    np.testing.assert_array_equal(reward._multiplicities, drawn)
    alone = model(answered(recorded(), 20), members=1)
    alone.train(1)
    assert (alone._multiplicities == 1).all()
    assert alone.losses.keys() == {"training"}


def test_a_member_is_not_fitted_to_what_it_does_not_see() -> None:
    reward = model(answered(recorded(), 20), members=2, weight_decay=0.0)
    reward._multiplicities = np.array([[0.0, 1.0]] * 20, dtype=np.float32)
    unseen, seen = parameters(reward, 0), parameters(reward, 1)
    reward.train(1)
    assert all(torch.equal(*pair) for pair in zip(unseen, parameters(reward, 0), strict=True))
    assert not all(torch.equal(*pair) for pair in zip(seen, parameters(reward, 1), strict=True))


def test_it_goes_on_exactly() -> None:
    recording = recorded()
    answers = answered(recording, 50)
    whole = model(answers)
    whole.train(6)
    first = model(answers)
    first.train(4)
    second = model(answers, seed=0)
    arrays, metadata = first.state_dict()
    second.load_state_dict(arrays, metadata)
    second.train(2)
    np.testing.assert_array_equal(second.predict(recording), whole.predict(recording))
    assert second.losses == whole.losses


def test_disagreement_is_the_variance_of_the_probability() -> None:
    # One step of 0 or of the log odds: member 0 says 3 : 1 for the first, member 1 says 1 : 3.
    odds = np.log(3)
    rewards = np.array([[[odds], [0.0]], [[0.0], [odds]]])
    pairs = Pairs(np.array([[0, 1], [1, 1]]), np.zeros((2, 2), dtype=np.int64), 1)
    np.testing.assert_allclose(disagreement(rewards, pairs), [0.25**2, 0.0])
    assert disagreement(rewards[:1], pairs).tolist() == [0, 0]
    extreme = disagreement(rewards * 1e4, pairs)
    np.testing.assert_allclose(extreme, [0.25, 0.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"architecture": "resnet"}, r"architecture is 'resnet'; it must be one of \['fast', 'paper'\]"),
        ({"members": 0}, "members is 0; it must be at least 1"),
        ({"updates": 0}, "updates is 0"),
        ({"initial_updates": -1}, "initial_updates is -1; it must be at least 0"),
        ({"batch_size": 0}, "batch_size is 0"),
        ({"lapse": 1.0}, "lapse is 1.0; it must be at least 0 and below 1"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0; it must be positive"),
        ({"weight_decay": -1.0}, "weight_decay is -1.0; it must be finite and not negative"),
    ],
)
def test_impossible_configurations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        config(**changes)

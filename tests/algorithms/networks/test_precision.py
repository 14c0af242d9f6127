"""Half precision where it is fast, single precision where it is not, and little difference between them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces

from moral_algorithms.networks import policies, rewards
from moral_algorithms.networks.precision import fast_matmul, has_fast_bfloat16
from moral_envs import emergency_v0
from moral_envs.world import NUM_ACTIONS
from tests.algorithms.tiny import seeded_engine

CPU = torch.device("cpu")


@pytest.fixture
def _fresh_cache() -> Iterator[None]:
    has_fast_bfloat16.cache_clear()
    yield
    has_fast_bfloat16.cache_clear()


_TILES, _VECTORS = "_is_amx_tile_supported", "_is_avx512_bf16_supported"


@pytest.mark.usefixtures("_fresh_cache")
@pytest.mark.parametrize(
    ("answers", "dtype"),
    [
        ({_TILES: True, _VECTORS: True}, torch.bfloat16),
        ({_TILES: False, _VECTORS: True}, torch.bfloat16),
        ({_TILES: True}, torch.bfloat16),
        ({_TILES: False, _VECTORS: False}, torch.float32),
        ({}, torch.float32),
    ],
)
def test_instructions_decide(
    monkeypatch: pytest.MonkeyPatch, answers: dict[str, bool], dtype: torch.dtype
) -> None:
    # A PyTorch that does not know a question has no such function.
    for question in (_TILES, _VECTORS):
        if question in answers:
            monkeypatch.setattr(torch.cpu, question, lambda found=answers[question]: found, raising=False)
        else:
            monkeypatch.delattr(torch.cpu, question, raising=False)
    with fast_matmul(CPU):
        product = torch.eye(2) @ torch.eye(2)
    assert product.dtype == dtype
    assert (torch.eye(2) @ torch.eye(2)).dtype == torch.float32


@pytest.mark.usefixtures("_fresh_cache")
def test_an_unknown_device_computes_in_single_precision() -> None:
    assert not has_fast_bfloat16("mps")
    assert isinstance(fast_matmul(torch.device("mps")), nullcontext)


def values(monkeypatch: pytest.MonkeyPatch, context: AbstractContextManager[Any]) -> list[np.ndarray]:
    """What every network says of the same states in a given precision."""
    for module in (policies, rewards):
        monkeypatch.setattr(module, "fast_matmul", lambda device: context)
    engine = seeded_engine(emergency_v0.world(), 50)
    states = torch.from_numpy(engine.observe()[:, 0])
    engine.step(np.arange(50) % NUM_ACTIONS)
    after = torch.from_numpy(engine.observe()[:, 0])
    space = spaces.Box(0, 1, engine.observation_shape, np.uint8)
    found = []
    with torch.no_grad():
        for policy in policies.POLICIES.values():
            torch.manual_seed(0)
            network = policy(space, spaces.Discrete(NUM_ACTIONS), lambda _: 1e-3)
            assert network.predict_values(states).dtype == torch.float32
            found.append(network.predict_values(states).numpy())
            found.append(network.get_distribution(states).distribution.logits.numpy())  # type: ignore[union-attr]
        for architecture in rewards.REWARD_ARCHITECTURES:
            torch.manual_seed(0)
            reward = rewards.ShapedRewardNetwork(engine.observation_shape, architecture, 0.9)(states, after)
            assert reward.dtype == torch.float32
            found.append(reward.numpy())
    return found


def test_both_precisions_give_close_values(monkeypatch: pytest.MonkeyPatch) -> None:
    single = values(monkeypatch, nullcontext())
    half = values(monkeypatch, torch.autocast("cpu", torch.bfloat16))
    assert any((one != other).any() for one, other in zip(single, half, strict=True))
    for one, other in zip(single, half, strict=True):
        # bfloat16 has eight bits: a value is off by 1/512 at most in each of a handful of roundings, and what
        # is left after a subtraction by more. A tenth of the spread over states would mean other layers.
        assert np.abs(other - one).max() < 0.1 * one.std()

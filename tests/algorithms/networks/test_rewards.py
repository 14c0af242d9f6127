"""Reward networks: AIRL's form of the reward, and the thesis's layers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import nn

from moral_algorithms.networks.rewards import (
    REWARD_ARCHITECTURES,
    CountingEncoding,
    RewardArchitecture,
    ShapedRewardNetwork,
)
from moral_envs import delivery_v0, emergency_v0
from moral_envs.engine import Engine
from moral_envs.world import World
from tests.algorithms.tiny import seeded_engine

EMERGENCY = emergency_v0.world()
DELIVERY = delivery_v0.world()


def transitions(world: World, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """States and next states under random actions, uint8."""
    engine = seeded_engine(world, count)
    rng = np.random.default_rng(0)
    for _ in range(10):
        engine.step(rng.integers(9, size=count))
    before = engine.observe()[:, 0]
    engine.step(rng.integers(9, size=count))
    return torch.from_numpy(before), torch.from_numpy(engine.observe()[:, 0])


class Total(nn.Module):
    """The sum over a plane."""

    def __init__(self, plane: int) -> None:
        super().__init__()
        self.plane = plane

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        return states[:, self.plane].sum(dim=(1, 2))[:, None]


def total(plane: int, factor: float) -> nn.Sequential:
    """A constant times the sum over a plane, so that f can be computed by hand."""
    head = nn.Linear(1, 1, bias=False)
    nn.init.constant_(head.weight, factor)
    return nn.Sequential(Total(plane), head)


def test_the_reward_is_g_plus_discounted_difference_of_h(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = iter([total(2, 3.0), total(1, 5.0)])
    totals = RewardArchitecture(lambda shape: nn.Identity(), lambda shape: next(parts))
    monkeypatch.setitem(REWARD_ARCHITECTURES, "totals", totals)
    network = ShapedRewardNetwork((3, 4, 4), "totals", gamma=0.5)
    states = torch.zeros(2, 3, 4, 4, dtype=torch.uint8)
    next_states = torch.zeros_like(states)
    states[0, 2, 0, :3] = 1  # g = 3 * 3
    states[0, 1, 1, 0] = 1  # h = 5
    next_states[0, 1, 1, :4] = 1  # h' = 20
    next_states[1, 2] = 1  # g does not look at the next state
    states[1, 1, 0, :2] = 1  # h = 10
    values = network(states, next_states)
    assert values.tolist() == [9 + 0.5 * 20 - 5, 0 + 0.5 * 0 - 10]
    assert values.dtype == torch.float32


@pytest.mark.parametrize("architecture", REWARD_ARCHITECTURES)
@pytest.mark.parametrize("world", [EMERGENCY, DELIVERY], ids=["emergency", "delivery"])
def test_every_architecture_composes_its_two_networks(architecture: str, world: World) -> None:
    states, next_states = transitions(world, 6)
    torch.manual_seed(0)
    network = ShapedRewardNetwork(tuple(states.shape[1:]), architecture, gamma=0.9)  # type: ignore[arg-type]
    values = network(states, next_states)
    assert values.shape == (6,)
    with torch.no_grad():
        now, later = network.encoding(states.float()), network.encoding(next_states.float())
        g, h, after = network.g(now), network.h(now), network.h(later)
    expected = (g + 0.9 * after - h).squeeze(1)
    # The network may multiply in bfloat16; its values are about 0.1.
    torch.testing.assert_close(values, expected, atol=5e-3, rtol=0)
    # g and h do not share parameters, and both learn.
    values.sum().backward()
    assert all(parameter.grad is not None for parameter in network.parameters())
    assert not {id(p) for p in network.g.parameters()} & {id(p) for p in network.h.parameters()}


def test_mlp_has_the_layers_of_figure_3_5() -> None:
    network = ShapedRewardNetwork((4, 8, 8), "mlp").g
    linear = [module for module in network.modules() if isinstance(module, nn.Linear)]
    assert [(m.in_features, m.out_features) for m in linear] == [(256, 256), (256, 512), (512, 256), (256, 1)]
    slopes = [module.negative_slope for module in network.modules() if isinstance(module, nn.LeakyReLU)]
    assert slopes == [0.01] * 3


def test_conv_has_the_layers_of_appendix_b_1_2() -> None:
    network = ShapedRewardNetwork((6, 16, 16), "conv").g
    convolutions = [module for module in network.modules() if isinstance(module, nn.Conv2d)]
    assert [(c.in_channels, c.out_channels) for c in convolutions] == [(6, 32), (32, 32), (32, 16)]
    assert all(c.kernel_size == (2, 2) and c.stride == (1, 1) and c.padding == (0, 0) for c in convolutions)
    (linear,) = (module for module in network.modules() if isinstance(module, nn.Linear))
    assert (linear.in_features, linear.out_features) == (16 * 13 * 13, 1)
    slopes = [module.negative_slope for module in network.modules() if isinstance(module, nn.LeakyReLU)]
    assert slopes == [0.01] * 3


def test_fast_tells_a_removed_object_from_one_out_of_sight() -> None:
    # Same crop around the agent, another number of boxes far away.
    states = torch.zeros(2, *Engine(DELIVERY).observation_shape)
    states[:, 0] = torch.from_numpy(Engine(DELIVERY).observe()[0, 0, 0])
    states[:, 1, 1, 1] = 1
    states[1, 2, 14, 14] = 1
    torch.manual_seed(0)
    network = ShapedRewardNetwork(Engine(DELIVERY).observation_shape, "fast")
    with torch.no_grad():
        first, second = network.g(network.encoding(states))[:, 0].tolist()
    assert first != second


def test_an_unknown_architecture_is_refused() -> None:
    known = r"\['conv', 'counting', 'fast', 'mlp'\]"
    with pytest.raises(ValueError, match=rf"'resnet'; it must be one of {known}"):
        ShapedRewardNetwork((4, 8, 8), "resnet")


def test_states_of_another_shape_are_refused() -> None:
    network = ShapedRewardNetwork((4, 8, 8), "mlp")
    right = torch.zeros(2, 4, 8, 8)
    with pytest.raises(AssertionError, match="is not"):
        network(torch.zeros(2, 4, 7, 8), torch.zeros(2, 4, 7, 8))
    with pytest.raises(AssertionError, match="is not"):
        network(right, right[:1])


def test_a_constant_in_the_potential_costs_no_precision() -> None:
    torch.manual_seed(0)
    states, next_states = transitions(EMERGENCY, 6)
    network = ShapedRewardNetwork((4, 8, 8), "fast", 0.9)
    with torch.no_grad():
        before = network(states, next_states)
        head = network.h[-1]
        assert isinstance(head, nn.Linear)
        head.bias += 10
        after = network(states, next_states)
    # (gamma - 1) * 10, exact but for float32's rounding of numbers around ten.
    np.testing.assert_allclose((after - before).numpy(), -1.0, atol=1e-5)


def test_counts_are_ones_for_what_is_missing() -> None:
    states, _ = transitions(DELIVERY, 7)
    channels = states.shape[1]
    encoded = CountingEncoding(tuple(states.shape[1:]))(states)
    unary = encoded[:, -16 * channels :].reshape(7, channels, 16)
    totals = states.flatten(2).sum(dim=2)
    for row, plane in np.ndindex(7, channels):
        for count in range(1, 17):
            assert unary[row, plane, count - 1] == (totals[row, plane] < count)

"""Reward networks: AIRL's form of the reward, and the thesis's layers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import nn

from moral_algorithms.networks.egocentric import EgocentricCrop
from moral_algorithms.networks.rewards import (
    REWARD_ARCHITECTURES,
    RewardArchitecture,
    ShapedRewardNetwork,
)
from moral_algorithms.networks.sparse import Rows, SparseLinear, SparseRows
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
    totals = RewardArchitecture(lambda shape: torch.from_numpy, lambda shape: next(parts))
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


def as_matrix(rows: Rows) -> torch.Tensor:
    """Encoded states as float32."""
    return rows.dense() if isinstance(rows, SparseRows) else rows.float()


def plain(network: nn.Sequential) -> nn.Sequential:
    """The same layers, of which the first takes a matrix."""
    layers = list(network)
    if isinstance(layers[0], SparseLinear):
        first = nn.Linear(layers[0].in_features, layers[0].out_features)
        first.load_state_dict(layers[0].state_dict())
        layers[0] = first
    return nn.Sequential(*layers)


@pytest.mark.parametrize("architecture", REWARD_ARCHITECTURES)
@pytest.mark.parametrize("world", [EMERGENCY, DELIVERY], ids=["emergency", "delivery"])
def test_every_architecture_composes_its_two_networks(architecture: str, world: World) -> None:
    states, next_states = transitions(world, 6)
    torch.manual_seed(0)
    network = ShapedRewardNetwork(tuple(states.shape[1:]), architecture, gamma=0.9)  # type: ignore[arg-type]
    values = network(states, next_states)
    assert values.shape == (6,)
    encoded = [as_matrix(network.encode(part.numpy())) for part in (states, next_states)]
    with torch.no_grad():
        g, h, after = (
            plain(part)(inputs)
            for part, inputs in ((network.g, encoded[0]), (network.h, encoded[0]), (network.h, encoded[1]))
        )
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
        (first, second), _ = network.values(network.encode(states.numpy().astype(np.uint8)))
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


@pytest.mark.parametrize("architecture", ["fast", "counting"])
def test_values_combine_to_the_reward(architecture: str) -> None:
    states, next_states = transitions(DELIVERY, 9)
    torch.manual_seed(0)
    network = ShapedRewardNetwork(Engine(DELIVERY).observation_shape, architecture, gamma=0.9)
    with torch.no_grad():
        g, h = network.values(network.encode(states.numpy()))
        _, next_h = network.values(network.encode(next_states.numpy()))
        combined = network.combine(g, h, next_h)
        torch.testing.assert_close(combined, network(states, next_states), atol=5e-3, rtol=0)
        torch.testing.assert_close(combined, g + 0.9 * next_h - h)


def totals_seen(architecture: str, states: torch.Tensor) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """What follows the crop in encoded states, shape (n, C, k), and the totals, shape (n, C)."""
    count, channels = states.shape[:2]
    shape = tuple(states.shape[1:])
    encoded = as_matrix(ShapedRewardNetwork(shape, architecture).encode(states.numpy()))  # type: ignore[arg-type]
    cropped = EgocentricCrop(shape, 5)(states)  # type: ignore[arg-type]
    torch.testing.assert_close(encoded[:, : cropped.shape[1]], cropped.float())
    seen = encoded[:, cropped.shape[1] :].reshape(count, channels, -1).numpy()
    return seen, states.flatten(2).sum(dim=2).numpy()


@pytest.mark.parametrize("world", [EMERGENCY, DELIVERY], ids=["emergency", "delivery"])
def test_fast_is_shown_a_tenth_of_the_totals(world: World) -> None:
    seen, totals = totals_seen("fast", transitions(world, 7)[0])
    np.testing.assert_allclose(seen[:, :, 0], totals * 0.1, rtol=1e-6)


def test_counting_is_shown_ones_for_what_is_missing() -> None:
    states, _ = transitions(DELIVERY, 7)
    # More than can be counted, and nothing at all.
    states[0, 2, 1:-1, 1:-1] = 1
    states[1, 3] = 0
    seen, totals = totals_seen("counting", states)
    assert seen.shape == (7, 6, 16)
    for count in range(1, 17):
        np.testing.assert_array_equal(seen[:, :, count - 1], totals < count)


def test_totals_of_large_grids_are_counted() -> None:
    states = torch.zeros(1, 3, 20, 30, dtype=torch.uint8)
    states[0, 1, 10, 10] = 1
    states[0, 2] = 1
    seen, totals = totals_seen("fast", states)
    assert totals.tolist() == [[0, 1, 600]]
    np.testing.assert_allclose(seen[0, :, 0], [0, 0.1, 60], rtol=1e-6)

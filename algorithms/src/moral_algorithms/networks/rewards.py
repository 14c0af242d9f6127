"""Reward networks: AIRL's f(s, s') = g(s) + gamma * h(s') - h(s), and ensembles of r(s, a) for DRLHP."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from moral_algorithms.networks.egocentric import EgocentricCrop, SparseEgocentricCrop, planes_of
from moral_algorithms.networks.precision import fast_matmul
from moral_algorithms.networks.sparse import (
    Atoms,
    Dictionary,
    Entries,
    Rows,
    SparseLinear,
    SparseRows,
    concatenate,
)

Shape = tuple[int, int, int]

_COUNTED = 16
"""Objects of a kind that can be counted in unary."""


class SurroundingsAndTotals:
    """The crop around the agent and how much of each plane is left in the whole grid; nothing to learn.

    From the crop alone, an object that was removed looks like one that was left behind.

    Parameters
    ----------
    shape
        Shape (C, H, W) of a state.
    shown
        What the network is shown for a total of 0, 1, 2 and so on, float32 of shape (most + 1, k); larger
        totals are shown as the last.
    radius
        Cells seen in each direction.

    Attributes
    ----------
    size : int
        Length of an encoded state.
    """

    def __init__(self, shape: Shape, shown: torch.Tensor, radius: int = 5) -> None:
        channels = shape[0]
        totals, inputs = shown.shape
        self._crop = SparseEgocentricCrop(shape, radius)
        self.size = self._crop.size + channels * inputs
        firsts = range(self._crop.size, self.size, inputs)
        parts = [Atoms(slice(first, first + inputs), shown) for first in firsts]
        self._dictionary = Dictionary(self.size, (*self._crop.dictionary.parts, *parts))
        self._most = totals - 1
        self._firsts = self._crop.dictionary.count + np.arange(channels) * totals

    def __call__(self, states: NDArray[np.uint8]) -> SparseRows:
        """Encode states (n, C, H, W), 0/1 planes."""
        count, channels = states.shape[:2]
        totals = np.minimum(_totals(states), self._most) + self._firsts
        entries = Entries(np.repeat(np.arange(count), channels), totals.ravel())
        return SparseRows.from_entries([*self._crop.entries(states), entries], count, self._dictionary)


def _totals(states: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Count the ones on each plane of states (n, C, H, W), shape (n, C)."""
    # Bytes are added up fastest in a byte, which holds no more than 255, and by PyTorch.
    parts = torch.split(torch.from_numpy(np.ascontiguousarray(states)).flatten(2), 255, dim=2)
    sums: NDArray[np.int64] = (
        torch.stack([part.sum(dim=2, dtype=torch.uint8) for part in parts]).sum(0).numpy()
    )
    return sums


def _with_numbers(shape: Shape) -> SurroundingsAndTotals:
    """Show totals as numbers; a tenth of them, so that they and the cells enter on one scale."""
    _, height, width = shape
    return SurroundingsAndTotals(shape, torch.arange(height * width + 1)[:, None] * 0.1)


def _with_counts(shape: Shape) -> SurroundingsAndTotals:
    """Show totals in unary: a one for each of 1 to 16 that is not reached.

    As a number on the scale of a cell, one vase of eight more or less hardly shows. A one is what is missing,
    for what has never been missing then has no part in the reward: weight decay forgets it.
    """
    return SurroundingsAndTotals(shape, torch.ones(_COUNTED + 1, _COUNTED).triu())


def _encoded_value(size: int, hidden: int = 128) -> nn.Sequential:
    """Build a perceptron on an encoding of so many inputs."""
    return nn.Sequential(
        SparseLinear(size, hidden),
        nn.LeakyReLU(),
        nn.Linear(hidden, hidden),
        nn.LeakyReLU(),
        nn.Linear(hidden, 1),
    )


def _egocentric_value(shape: Shape) -> nn.Sequential:
    return _encoded_value(_with_numbers(shape).size)


def _counting_value(shape: Shape) -> nn.Sequential:
    return _encoded_value(_with_counts(shape).size)


def _perceptron_value(shape: Shape) -> nn.Sequential:
    """Build the thesis's network in Emergency (figure 3.5)."""
    channels, height, width = shape
    sizes = (channels * height * width, 256, 512, 256)
    layers: list[nn.Module] = [nn.Flatten()]
    for inputs, outputs in pairwise(sizes):
        layers += [nn.Linear(inputs, outputs), nn.LeakyReLU(0.01)]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], 1))


def _convolutional_value(shape: Shape) -> nn.Sequential:
    """Build the thesis's network in Delivery (B.1.2)."""
    channels, height, width = shape
    return nn.Sequential(
        nn.Conv2d(channels, 32, 2),
        nn.LeakyReLU(0.01),
        nn.Conv2d(32, 32, 2),
        nn.LeakyReLU(0.01),
        nn.Conv2d(32, 16, 2),
        nn.LeakyReLU(0.01),
        nn.Flatten(),
        nn.Linear(16 * (height - 3) * (width - 3), 1),
    )


class RewardArchitecture(NamedTuple):
    """What g and h are made of, as functions of the shape (C, H, W) of a state."""

    encoding: Callable[[Shape], Callable[[NDArray[np.uint8]], Rows]]
    """Makes what turns states (n, C, H, W) into the input that g and h share; it learns nothing."""
    value: Callable[[Shape], nn.Sequential]
    """Makes g, and h: a network from that input to (n, 1) that ends in a linear layer."""


def _as_they_are(shape: Shape) -> Callable[[NDArray[np.uint8]], Rows]:
    return torch.from_numpy


REWARD_ARCHITECTURES = {
    "fast": RewardArchitecture(_with_numbers, _egocentric_value),
    "counting": RewardArchitecture(_with_counts, _counting_value),
    "mlp": RewardArchitecture(_as_they_are, _perceptron_value),
    "conv": RewardArchitecture(_as_they_are, _convolutional_value),
}
"""The architectures by name."""


class ShapedRewardNetwork(nn.Module):
    """AIRL's reward f(s, s') = g(s) + gamma * h(s') - h(s) (thesis 3.2.3; Fu et al. 2018).

    Parameters
    ----------
    shape
        Shape (C, H, W) of a state.
    architecture
        A name of :data:`REWARD_ARCHITECTURES`, for g and h alike.
    gamma
        Discount factor of the shaping term.

    Raises
    ------
    ValueError
        If the architecture is unknown.
    """

    def __init__(self, shape: Shape, architecture: str = "fast", gamma: float = 0.97) -> None:
        super().__init__()
        if architecture not in REWARD_ARCHITECTURES:
            raise ValueError(
                f"architecture is {architecture!r}; it must be one of {sorted(REWARD_ARCHITECTURES)}"
            )
        self.shape = shape
        self.architecture = architecture
        self.gamma = gamma
        encoding, value = REWARD_ARCHITECTURES[architecture]
        self._encoding = encoding(shape)
        self.g = value(shape)
        self.h = value(shape)

    def forward(self, states: torch.Tensor, next_states: torch.Tensor) -> torch.Tensor:
        """Rewards of a batch of transitions.

        Parameters
        ----------
        states, next_states
            0/1 planes of any dtype, shape (n, C, H, W).

        Returns
        -------
        float32 tensor of shape (n,)
        """
        assert states.shape[1:] == self.shape, f"{tuple(states.shape)} is not (n, *{self.shape})"
        assert states.shape == next_states.shape, f"{tuple(states.shape)} is not {tuple(next_states.shape)}"
        return self.of_encoded(self.encode(planes_of(states)), self.encode(planes_of(next_states)))

    def encode(self, states: NDArray[np.uint8]) -> Rows:
        """Make of states (n, C, H, W), 0/1 planes, what g and h share; nothing is learned in it."""
        encoded = self._encoding(states)
        return encoded.to(next(self.parameters()).device) if isinstance(encoded, torch.Tensor) else encoded

    def of_encoded(self, states: Rows, next_states: Rows) -> torch.Tensor:
        """Rewards (n,) of states and next states that have been through ``encode``."""
        count = len(states)
        potentials = _outputs(self.h, concatenate([states, next_states]))[:, 0]
        return self.combine(_outputs(self.g, states)[:, 0], potentials[:count], potentials[count:])

    def values(self, states: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        """Compute g and h, both of shape (n,), of states that have been through ``encode``."""
        return _outputs(self.g, states)[:, 0], _outputs(self.h, states)[:, 0]

    def combine(self, g: torch.Tensor, h: torch.Tensor, next_h: torch.Tensor) -> torch.Tensor:
        """Compute f, all of shape (n,)."""
        return g + self.gamma * next_h - h


def _outputs(network: nn.Sequential, inputs: Rows) -> torch.Tensor:
    """Apply g or h, the last layer in full precision: f is a small difference of large potentials."""
    rows = inputs if isinstance(inputs, SparseRows) else inputs.float()
    with fast_matmul(next(network.parameters()).device):
        latent = network[:-1](rows)
    values: torch.Tensor = network[-1](latent.float())
    return values


# An action touches the neighbouring cells only, and a network that sees more needs more answers.
_REACH = 1


def _surroundings(shape: Shape) -> EgocentricCrop:
    return EgocentricCrop(shape, _REACH)


class _EgocentricActionValue(nn.Module):
    """A perceptron on the cells around the agent with one output for each action."""

    def __init__(self, shape: Shape, num_actions: int, hidden: int = 128) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(_surroundings(shape).size, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, num_actions),
        )

    def forward(self, encoded: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Rewards (n, 1) of encoded states (n, size) and int64 actions (n,)."""
        return _outputs(self.layers, encoded).gather(1, actions[:, None])


class _ConvolutionalActionValue(nn.Module):
    """The thesis's network (B.1.3): the action, embedded as so many planes again, beside the state's."""

    def __init__(self, shape: Shape, num_actions: int) -> None:
        super().__init__()
        channels, height, width = shape
        self.shape = shape
        self.num_actions = num_actions
        self.embedding = nn.Linear(num_actions, channels * height * width)
        self.layers = nn.Sequential(
            nn.Conv2d(2 * channels, 128, 2),
            nn.LeakyReLU(0.01),
            nn.Conv2d(128, 64, 2),
            nn.LeakyReLU(0.01),
            nn.Conv2d(64, 32, 2),
            nn.LeakyReLU(0.01),
            nn.Flatten(),
            nn.Linear(32 * (height - 3) * (width - 3), 1),
        )

    def forward(self, states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Rewards (n, 1) of float32 states (n, C, H, W) and int64 actions (n,)."""
        one_hot = functional.one_hot(actions, self.num_actions).float()
        embedded = self.embedding(one_hot).reshape(-1, *self.shape)
        planes = torch.cat([states, embedded], dim=1).contiguous(memory_format=torch.channels_last)
        return _outputs(self.layers, planes)


class ActionRewardArchitecture(NamedTuple):
    """What r(s, a) is made of, as functions of the shape (C, H, W) of a state."""

    encoding: Callable[[Shape], nn.Module]
    """Makes the input that the members of an ensemble share; it learns nothing."""
    value: Callable[[Shape, int], nn.Module]
    """Makes, for a number of actions, a network from that input and the actions to (n, 1)."""


ACTION_REWARD_ARCHITECTURES = {
    "fast": ActionRewardArchitecture(_surroundings, _EgocentricActionValue),
    "paper": ActionRewardArchitecture(lambda shape: nn.Identity(), _ConvolutionalActionValue),
}
"""The architectures of r(s, a) by name."""


class ActionRewardEnsemble(nn.Module):
    """Reward networks r(s, a) that are learned from preferences side by side (thesis B.1.3).

    What preferences say of a reward leaves its offset and, in practice, its scale open: agents are given the
    mean over members of each one's standardised reward (Christiano et al. 2017, section 2.2).

    Parameters
    ----------
    shape
        Shape (C, H, W) of a state.
    num_actions
        How many actions there are.
    architecture
        A name of :data:`ACTION_REWARD_ARCHITECTURES`.
    members
        How many networks.

    Raises
    ------
    ValueError
        If the architecture is unknown, or there is no member.
    """

    means: torch.Tensor
    scales: torch.Tensor

    def __init__(self, shape: Shape, num_actions: int, architecture: str = "fast", members: int = 1) -> None:
        super().__init__()
        if architecture not in ACTION_REWARD_ARCHITECTURES:
            known = sorted(ACTION_REWARD_ARCHITECTURES)
            raise ValueError(f"architecture is {architecture!r}; it must be one of {known}")
        if members < 1:
            raise ValueError(f"members is {members}; it must be at least 1")
        self.shape = shape
        self.num_actions = num_actions
        self.architecture = architecture
        encoding, value = ACTION_REWARD_ARCHITECTURES[architecture]
        self.encoding = encoding(shape)
        self.members = nn.ModuleList(value(shape, num_actions) for _ in range(members))
        self.register_buffer("means", torch.zeros(members))
        # Nothing is known of the reward yet, and nothing is paid.
        self.register_buffer("scales", torch.zeros(members))

    def forward(self, states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Rewards as each member predicts them.

        Parameters
        ----------
        states
            0/1 planes of any dtype, shape (n, C, H, W).
        actions
            Integers of shape (n,).

        Returns
        -------
        float32 tensor of shape (members, n)
        """
        assert states.shape[1:] == self.shape, f"{tuple(states.shape)} is not (n, *{self.shape})"
        assert actions.shape == states.shape[:1], f"{tuple(actions.shape)} is not ({len(states)},)"
        encoded, taken = self.encoding(states).float(), actions.long()
        return torch.cat([member(encoded, taken) for member in self.members], dim=1).T

    def standardised(self, states: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
        """Mean over members of the standardised rewards, float32 of shape (n,); 0 before the first scale."""
        rewards: torch.Tensor = (self(states, actions) - self.means[:, None]) * self.scales[:, None]
        return rewards.mean(dim=0)

    @torch.no_grad()
    def standardise(self, states: torch.Tensor, actions: torch.Tensor) -> None:
        """Give every member's rewards mean 0 and standard deviation 1 on these states and actions."""
        rewards = self(states, actions)
        self.means.copy_(rewards.mean(dim=1))
        # A constant reward stays 0 instead of becoming noise.
        self.scales.copy_(1 / rewards.std(dim=1, correction=0).clamp(min=1e-4))

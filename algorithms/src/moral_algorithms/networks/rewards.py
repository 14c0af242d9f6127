"""Reward networks: AIRL's f(s, s') = g(s) + gamma * h(s') - h(s), and ensembles of r(s, a) for DRLHP."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from moral_algorithms.networks.egocentric import EgocentricCrop
from moral_algorithms.networks.precision import fast_matmul

Shape = tuple[int, int, int]

_COUNTED = 16
"""Objects of a kind that can be counted in unary."""


class EgocentricEncoding(nn.Module):
    """The crop around the agent and how much of each plane is left in the whole grid; nothing to learn.

    From the crop alone, an object that was removed looks like one that was left behind.
    """

    def __init__(self, shape: Shape, radius: int = 5) -> None:
        super().__init__()
        self.crop = EgocentricCrop(shape, radius)
        self.size = self.crop.size + shape[0]

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Encode states (n, C, H, W), 0/1 planes of any dtype, as float32 (n, size)."""
        # A tenth, so that counts and 0/1 cells enter on one scale.
        return torch.cat([self.crop(states).float(), _totals(states) * 0.1], dim=1)


class CountingEncoding(nn.Module):
    """As :class:`EgocentricEncoding`, the totals in unary: a one for each of 1 to 16 that is not reached.

    As a number on the scale of a cell, one vase of eight more or less hardly shows. A one is what is missing,
    for what has never been missing then has no part in the reward: weight decay forgets it.
    """

    def __init__(self, shape: Shape, radius: int = 5) -> None:
        super().__init__()
        self.crop = EgocentricCrop(shape, radius)
        self.register_buffer("_steps", torch.arange(1, _COUNTED + 1), persistent=False)
        self.size = self.crop.size + shape[0] * _COUNTED

    _steps: torch.Tensor

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        """Encode states (n, C, H, W), 0/1 planes of any dtype, as (n, size) of the same dtype."""
        missing = _totals(states)[:, :, None] < self._steps
        return torch.cat([self.crop(states), missing.flatten(1).to(states.dtype)], dim=1)


def _totals(states: torch.Tensor) -> torch.Tensor:
    """Count the ones on each plane of states (n, C, H, W), as int32 of shape (n, C)."""
    # Bytes are added up fastest in a byte, which holds no more than 255.
    parts = torch.split(states.flatten(2), 255, dim=2)
    return torch.stack([part.sum(dim=2, dtype=torch.uint8) for part in parts]).sum(dim=0, dtype=torch.int32)


def _encoded_value(size: int, hidden: int = 128) -> nn.Sequential:
    """Build a perceptron on an encoding of so many numbers."""
    return nn.Sequential(
        nn.Linear(size, hidden),
        nn.LeakyReLU(),
        nn.Linear(hidden, hidden),
        nn.LeakyReLU(),
        nn.Linear(hidden, 1),
    )


def _egocentric_value(shape: Shape) -> nn.Sequential:
    return _encoded_value(EgocentricEncoding(shape).size)


def _counting_value(shape: Shape) -> nn.Sequential:
    return _encoded_value(CountingEncoding(shape).size)


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

    encoding: Callable[[Shape], nn.Module]
    """Makes the input that g and h share."""
    value: Callable[[Shape], nn.Sequential]
    """Makes g, and h: a network from that input to (n, 1) that ends in a linear layer."""


def _as_it_is(shape: Shape) -> nn.Module:
    return nn.Identity()


REWARD_ARCHITECTURES = {
    "fast": RewardArchitecture(EgocentricEncoding, _egocentric_value),
    "counting": RewardArchitecture(CountingEncoding, _counting_value),
    "mlp": RewardArchitecture(_as_it_is, _perceptron_value),
    "conv": RewardArchitecture(_as_it_is, _convolutional_value),
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
        self.encoding = encoding(shape)
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
        return self.of_encoded(self.encoding(states), self.encoding(next_states))

    def of_encoded(self, states: torch.Tensor, next_states: torch.Tensor) -> torch.Tensor:
        """Rewards (n,) of states and next states that have been through ``encoding``."""
        count = states.shape[0]
        both = torch.cat([states, next_states]).float()
        potentials, base = _apply(self.h, both), _apply(self.g, both[:count])
        rewards: torch.Tensor = base + self.gamma * potentials[count:] - potentials[:count]
        return rewards.squeeze(1)


def _apply(network: nn.Sequential, inputs: torch.Tensor) -> torch.Tensor:
    """Apply g or h, the last layer in full precision: f is a small difference of large potentials."""
    with fast_matmul(inputs.device):
        latent = network[:-1](inputs)
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
        return _apply(self.layers, encoded).gather(1, actions[:, None])


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
        return _apply(self.layers, planes)


class ActionRewardArchitecture(NamedTuple):
    """What r(s, a) is made of, as functions of the shape (C, H, W) of a state."""

    encoding: Callable[[Shape], nn.Module]
    """Makes the input that the members of an ensemble share."""
    value: Callable[[Shape, int], nn.Module]
    """Makes, for a number of actions, a network from that input and the actions to (n, 1)."""


ACTION_REWARD_ARCHITECTURES = {
    "fast": ActionRewardArchitecture(_surroundings, _EgocentricActionValue),
    "paper": ActionRewardArchitecture(_as_it_is, _ConvolutionalActionValue),
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

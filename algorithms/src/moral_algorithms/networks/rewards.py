"""Reward networks: AIRL's f(s, s') = g(s) + gamma * h(s') - h(s), with g and h of three architectures."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn

from moral_algorithms.networks.egocentric import EgocentricCrop
from moral_algorithms.networks.precision import fast_matmul

Shape = tuple[int, int, int]


class _EgocentricValue(nn.Module):
    """A perceptron on the crop around the agent and on how much of each plane is left in the whole grid.

    From the crop alone, an object that was removed looks like one that was left behind.
    """

    def __init__(self, shape: Shape, radius: int = 5, hidden: int = 128) -> None:
        super().__init__()
        self.crop = EgocentricCrop(shape, radius)
        self.layers = nn.Sequential(
            nn.Linear(self.crop.size + shape[0], hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, hidden),
            nn.LeakyReLU(),
            nn.Linear(hidden, 1),
        )

    def forward(self, states: torch.Tensor) -> torch.Tensor:
        # A tenth, so that counts and 0/1 cells enter on one scale.
        totals = states.flatten(2).sum(dim=2) * 0.1
        values: torch.Tensor = self.layers(torch.cat([self.crop(states), totals], dim=1))
        return values


def _perceptron_value(shape: Shape) -> nn.Module:
    """The thesis's discriminator in Emergency (figure 3.5)."""
    channels, height, width = shape
    sizes = (channels * height * width, 256, 512, 256)
    layers: list[nn.Module] = [nn.Flatten()]
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        layers += [nn.Linear(inputs, outputs), nn.LeakyReLU(0.01)]
    return nn.Sequential(*layers, nn.Linear(sizes[-1], 1))


def _convolutional_value(shape: Shape) -> nn.Module:
    """The thesis's discriminator in Delivery (B.1.2)."""
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


REWARD_ARCHITECTURES: dict[str, Callable[[Shape], nn.Module]] = {
    "fast": _EgocentricValue,
    "mlp": _perceptron_value,
    "conv": _convolutional_value,
}
"""What g and h can be, by name: functions from the shape (C, H, W) of a state to a network."""


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
    """

    def __init__(self, shape: Shape, architecture: str = "fast", gamma: float = 0.97) -> None:
        super().__init__()
        if architecture not in REWARD_ARCHITECTURES:
            raise ValueError(f"architecture is {architecture!r}; it must be one of {sorted(REWARD_ARCHITECTURES)}")
        self.shape = shape
        self.architecture = architecture
        self.gamma = gamma
        self.g = REWARD_ARCHITECTURES[architecture](shape)
        self.h = REWARD_ARCHITECTURES[architecture](shape)

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
        assert states.shape == next_states.shape and states.shape[1:] == self.shape
        count = states.shape[0]
        with fast_matmul(states.device):
            both = torch.cat([states, next_states]).float()
            potentials = self.h(both)
            rewards = self.g(both[:count]) + self.gamma * potentials[count:] - potentials[:count]
        return rewards.float().squeeze(1)

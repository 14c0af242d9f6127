"""Reward networks for `imitation` like those of this project; imported only where it is installed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from imitation.rewards.reward_nets import BasicRewardNet, BasicShapedRewardNet, RewardNet


class UnendingRewardNet(BasicShapedRewardNet):  # type: ignore[misc]
    """AIRL's f = g(s) + gamma * h(s') - h(s), for episodes that are cut off and do not end.

    The library's own leaves h(s') out wherever an episode is over. PPO bootstraps there, because it is only
    cut off, and would take the lack of h(s') for something that the last action has done.
    """

    def forward(
        self, state: torch.Tensor, action: torch.Tensor, next_state: torch.Tensor, done: torch.Tensor
    ) -> torch.Tensor:
        """Rewards (n,) of a batch, whose episodes all go on."""
        rewards: torch.Tensor = super().forward(state, action, next_state, torch.zeros_like(done))
        return rewards


class NearbyRewardNet(RewardNet):  # type: ignore[misc]
    """A perceptron r(s, a) on the cells around the agent that an action reaches, out of a wider crop.

    Parameters
    ----------
    observation_space
        Flat crops of ``radius`` cells in each direction.
    action_space
        The actions.
    radius, reach
        Cells that the crops show in each direction, and those that are kept of them.
    hidden
        Sizes of the layers.
    """

    cells: torch.Tensor

    def __init__(
        self,
        observation_space: Space[Any],
        action_space: Space[Any],
        radius: int,
        reach: int,
        hidden: Sequence[int],
    ) -> None:
        super().__init__(observation_space, action_space)
        assert observation_space.shape is not None
        width = 2 * radius + 1
        kept = slice(radius - reach, radius + reach + 1)
        cells = np.arange(observation_space.shape[0]).reshape(-1, width, width)[:, kept, kept].reshape(-1)
        self.register_buffer("cells", torch.from_numpy(cells))
        near = Box(0, 1, cells.shape, np.uint8)
        self.net = BasicRewardNet(near, action_space, hid_sizes=hidden, activation=torch.nn.LeakyReLU)

    def forward(
        self, state: torch.Tensor, action: torch.Tensor, next_state: torch.Tensor, done: torch.Tensor
    ) -> torch.Tensor:
        """Rewards (n,) of a batch."""
        rewards: torch.Tensor = self.net(state[:, self.cells], action, next_state[:, self.cells], done)
        return rewards

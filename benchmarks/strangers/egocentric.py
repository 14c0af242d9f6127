"""An ordinary observation wrapper, as any user would write it: the planes around the agent."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

WALLS, AGENT = 0, 1


def crop(planes: NDArray[np.uint8], radius: int) -> NDArray[np.float32]:
    """Cut the square around the agent out of all planes but its own.

    Parameters
    ----------
    planes
        uint8 0/1 planes of shape (C, H, W), walls first and the agent second.
    radius
        Cells seen in each direction; beyond the world there is wall.

    Returns
    -------
    float32 array of shape ((C - 1) * (2 * radius + 1) ** 2,)
    """
    count, height, width = planes.shape
    row, column = divmod(int(planes[AGENT].argmax()), width)
    # By hand: np.pad takes ten times as long as everything else here.
    padded = np.zeros((count - 1, height + 2 * radius, width + 2 * radius), dtype=np.float32)
    padded[WALLS] = 1
    inside = padded[:, radius : radius + height, radius : radius + width]
    inside[:AGENT], inside[AGENT:] = planes[:AGENT], planes[AGENT + 1 :]
    window = padded[:, row : row + 2 * radius + 1, column : column + 2 * radius + 1]
    return np.ascontiguousarray(window).reshape(-1)


def batch_crop(planes: NDArray[np.uint8], radius: int) -> NDArray[np.uint8]:
    """Crop a batch as :func:`crop` does a single observation, as bytes.

    Parameters
    ----------
    planes
        uint8 0/1 planes of shape (n, C, H, W), walls first and the agent second.
    radius
        Cells seen in each direction; beyond the world there is wall.

    Returns
    -------
    uint8 array of shape (n, (C - 1) * (2 * radius + 1) ** 2)
    """
    batch, count, height, width = planes.shape
    agents = planes[:, AGENT].reshape(batch, -1).argmax(axis=1)
    around = np.arange(-radius, radius + 1)
    rows, columns = (agents // width)[:, None] + around, (agents % width)[:, None] + around
    inside = ((rows >= 0) & (rows < height))[:, :, None] & ((columns >= 0) & (columns < width))[:, None]
    # The top left corner stands for all that lies outside: it is wall, and nothing else is ever on it.
    cells = np.where(inside, rows[:, :, None] * width + columns[:, None], 0).reshape(batch, 1, -1)
    others = np.delete(planes, AGENT, axis=1).reshape(batch, count - 1, -1)
    window: NDArray[np.uint8] = np.take_along_axis(others, cells, axis=2).reshape(batch, -1)
    return window


def cropped_space(space: gymnasium.Space[Any], radius: int) -> Box:
    """Space of the crops of observations from ``space``."""
    assert space.shape is not None
    return Box(0, 1, ((space.shape[0] - 1) * (2 * radius + 1) ** 2,), np.float32)


class Egocentric(gymnasium.ObservationWrapper[NDArray[np.float32], int, NDArray[np.uint8]]):
    """One agent's observations, cropped around it; see :func:`crop`."""

    def __init__(self, env: gymnasium.Env[NDArray[np.uint8], int], radius: int) -> None:
        super().__init__(env)
        self.radius = radius
        self.observation_space: gymnasium.Space[Any] = cropped_space(env.observation_space, radius)

    def observation(self, observation: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Crop one observation."""
        return crop(observation, self.radius)

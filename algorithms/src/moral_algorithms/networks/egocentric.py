"""What the agent sees from where it stands: the planes cropped around it."""

from __future__ import annotations

import torch
from torch import nn

# Walls are on plane 0 and the agent on plane 1 in every world (World.plane_names).
AGENT_PLANE = 1


class EgocentricCrop(nn.Module):
    """Crops all planes but the agent's to a square around the agent; beyond the grid there is wall.

    Parameters
    ----------
    shape
        Shape (C, H, W) of an observation in a walled grid: walls on plane 0, the agent on plane 1.
    radius
        Cells seen in each direction.

    Attributes
    ----------
    size : int
        Length of the flattened crop, (C - 1) * (2 * radius + 1) ** 2.
    """

    cells: torch.Tensor
    sources: torch.Tensor

    def __init__(self, shape: tuple[int, int, int], radius: int) -> None:
        super().__init__()
        channels, height, width = shape
        self.shape = shape
        planes = torch.tensor([plane for plane in range(channels) if plane != AGENT_PLANE])
        self.size = len(planes) * (2 * radius + 1) ** 2
        cells = torch.arange(height * width)
        steps = torch.arange(-radius, radius + 1)
        rows = (cells // width)[:, None, None] + steps[:, None]
        columns = (cells % width)[:, None, None] + steps
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        # The top left corner stands for all that lies outside: it is wall, and nothing else is ever on it.
        window = torch.where(inside, rows * width + columns, 0).flatten(1)
        sources = (planes[:, None] * (height * width) + window[:, None]).flatten(1)
        self.register_buffer("cells", cells.float(), persistent=False)
        self.register_buffer("sources", sources, persistent=False)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Crop a batch.

        Parameters
        ----------
        observations
            0/1 planes of any dtype, shape (n, C, H, W).

        Returns
        -------
        Tensor of the observations' dtype, shape (n, size)
            uint8 takes the least time.
        """
        assert observations.shape[1:] == self.shape, f"{tuple(observations.shape)} is not (n, *{self.shape})"
        # A product finds the agent faster than argmax does, but bfloat16 cannot tell cells beyond 256 apart.
        with torch.autocast(observations.device.type, enabled=False):
            agents = (observations[:, AGENT_PLANE].flatten(1).float() @ self.cells).long()
        return observations.flatten(1).gather(1, self.sources.index_select(0, agents))

"""What the agent sees from where it stands: the planes cropped around it."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from moral_algorithms.networks.sparse import Atoms, Dictionary, Entries, SparseRows

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


class SparseEgocentricCrop:
    """The same crop as :class:`EgocentricCrop`, for a layer that skips zeros: faster for a large radius.

    A view of the empty grid, which its border walls, is one atom; objects and further walls are others.

    Parameters
    ----------
    shape, radius
        As there.

    Attributes
    ----------
    size : int
        Length of the flattened crop.
    dictionary : Dictionary
        The unit vectors of the crop's cells, then the views from every cell of an empty grid.
    """

    def __init__(self, shape: tuple[int, int, int], radius: int) -> None:
        channels, height, width = shape
        self.shape = shape
        self._radius, self._side = radius, 2 * radius + 1
        self._area = self._side**2
        self.size = (channels - 1) * self._area
        self._border = np.ones((height, width), dtype=np.bool_)
        self._border[1:-1, 1:-1] = False
        views = self._windows(self._border[None]).reshape(-1, self._area)
        walls = Atoms(slice(0, self._area), torch.from_numpy(views.astype(np.float32)))
        self.dictionary = Dictionary(self.size, (Atoms(slice(0, self.size)), walls))
        # With so much room between the ends of two rows, a displacement by rows and columns is one number.
        stride = width + radius
        rows, columns = np.divmod(np.arange(height * width, dtype=np.int32), width)
        self._positions = rows * stride + columns
        self._largest = int(self._positions[-1])
        self._cell_at = np.full(2 * self._largest + 1, -1, dtype=np.int32)
        steps = np.arange(-radius, radius + 1)
        displacements = (steps[:, None] * stride + steps).ravel() + self._largest
        possible = (displacements >= 0) & (displacements < len(self._cell_at))
        self._cell_at[displacements[possible]] = np.arange(self._area)[possible]

    def __call__(self, observations: NDArray[np.uint8]) -> SparseRows:
        """Crop a batch of 0/1 planes, shape (n, C, H, W).

        Raises
        ------
        ValueError
            If there is not one agent on every observation.
        """
        return SparseRows.from_entries(self.entries(observations), len(observations), self.dictionary)

    def entries(self, observations: NDArray[np.uint8]) -> list[Entries]:
        """Find what the rows of a batch are made of, as :meth:`SparseRows.from_entries` takes it."""
        count, *shape = observations.shape
        assert tuple(shape) == self.shape, f"{observations.shape} is not (n, *{self.shape})"
        planes = observations.view(np.bool_) if observations.dtype == np.uint8 else observations.astype(bool)
        every, walls = np.arange(count), planes[:, 0]
        found, agents = np.divmod(np.flatnonzero(planes[:, AGENT_PLANE]), self._border.size)
        if not np.array_equal(found, every):
            raise ValueError("observations have no agent or several; there must be one on each")
        objects = self._cells(planes[:, AGENT_PLANE + 1 :], agents, first_plane=1)
        views = self.size + agents
        if (walls == self._border).all():
            return [Entries(every, views), objects]
        closed: NDArray[np.bool_] = np.all(walls | ~self._border, axis=(1, 2))
        inner = walls & ~self._border & closed[:, None, None]
        # Where the border has gaps, the view is of no empty grid: every wall counts for itself.
        others = every[~closed]
        row, column = np.divmod(agents[others], self._border.shape[1])
        windows = self._windows(walls[others])[np.arange(len(others)), row, column]
        number, cell = np.nonzero(windows.reshape(len(others), self._area))
        return [
            Entries(every[closed], views[closed]),
            self._cells(inner[:, None], agents, first_plane=0),
            Entries(others[number], cell),
            objects,
        ]

    def _cells(self, planes: NDArray[np.bool_], agents: NDArray[np.int64], first_plane: int) -> Entries:
        """Find the ones of planes (n, k, H, W) in crops around agents on these cells."""
        count, depth = planes.shape[:2]
        cells = self._border.size
        found = np.flatnonzero(planes)
        firsts = np.arange(count + 1) * (depth * cells)
        lengths = np.diff(np.searchsorted(found, firsts))
        rows = np.repeat(np.arange(count), lengths)
        within = (found - np.repeat(firsts[:-1], lengths)).astype(np.int32)
        plane = within // cells
        origins = np.repeat(self._positions[agents] - self._largest, lengths)
        seen = self._cell_at[self._positions[within - plane * cells] - origins]
        near = np.flatnonzero(seen >= 0)
        return Entries(rows[near], seen[near] + (plane[near] + first_plane) * self._area)

    def _windows(self, walls: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """View walls (n, H, W) from each of their cells, shape (n, H, W, side, side)."""
        room = (self._radius, self._radius)
        padded = np.pad(walls, ((0, 0), room, room), constant_values=True)
        return np.lib.stride_tricks.sliding_window_view(padded, (self._side, self._side), axis=(1, 2))


def planes_of(observations: torch.Tensor) -> NDArray[np.uint8]:
    """Take 0/1 planes of any dtype, on any device, as an array; no gradient reaches them."""
    planes: NDArray[np.uint8] = observations.detach().to("cpu", torch.uint8).numpy()
    return planes

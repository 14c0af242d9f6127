"""The crop around the agent, against padding and slicing."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moral_algorithms.networks.egocentric import EgocentricCrop, SparseEgocentricCrop
from moral_algorithms.networks.precision import fast_matmul

CPU = torch.device("cpu")


def grids(
    rng: np.random.Generator, shape: tuple[int, int, int], cells: list[tuple[int, int]]
) -> NDArray[np.float32]:
    """One walled grid per agent's cell, with random objects on the free cells."""
    channels, height, width = shape
    planes = np.zeros((len(cells), *shape), dtype=np.float32)
    planes[:, 0] = 1
    planes[:, 0, 1:-1, 1:-1] = 0
    planes[:, 2:, 1:-1, 1:-1] = rng.integers(2, size=(len(cells), channels - 2, height - 2, width - 2))
    for grid, (row, column) in zip(planes, cells, strict=True):
        grid[1, row, column] = 1
    return planes


def slow_crop(planes: NDArray[np.float32], radius: int) -> NDArray[np.float32]:
    """Pad with wall and cut the square out of each grid, the agent's plane left out."""
    crops = []
    for grid in planes:
        ((row, column),) = np.argwhere(grid[1])
        padded = np.pad(grid, ((0, 0), (radius, radius), (radius, radius)))
        padded[0] = np.pad(grid[0], radius, constant_values=1)
        size = 2 * radius + 1
        crops.append(np.delete(padded[:, row : row + size, column : column + size], 1, axis=0).ravel())
    return np.array(crops)


@given(
    height=st.integers(3, 12),
    width=st.integers(3, 12),
    channels=st.integers(2, 7),
    radius=st.integers(0, 8),
    seed=st.integers(0, 1000),
)
def test_crops_as_padding_and_slicing_does(
    height: int, width: int, channels: int, radius: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    corners = [(1, 1), (1, width - 2), (height - 2, 1), (height - 2, width - 2)]
    cells = [*corners, (int(rng.integers(1, height - 1)), int(rng.integers(1, width - 1)))]
    planes = grids(rng, (channels, height, width), cells)
    crop = EgocentricCrop((channels, height, width), radius)
    cropped = crop(torch.from_numpy(planes))
    assert cropped.shape == (len(cells), crop.size)
    np.testing.assert_array_equal(cropped.numpy(), slow_crop(planes, radius))


@given(
    height=st.integers(3, 12),
    width=st.integers(3, 12),
    channels=st.integers(2, 7),
    radius=st.integers(0, 14),
    walls=st.sampled_from(["border", "inner", "gaps", "anything"]),
    dtype=st.sampled_from([np.uint8, np.float32, np.bool_]),
    seed=st.integers(0, 1000),
)
def test_sparse_crops_as_padding_and_slicing_does(
    height: int, width: int, channels: int, radius: int, walls: str, dtype: type, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    inner, border = walls in ("inner", "anything"), walls in ("gaps", "anything")
    lowest = 0 if border else 1
    cells = [
        (int(rng.integers(lowest, height - lowest)), int(rng.integers(lowest, width - lowest)))
        for _ in range(6)
    ]
    planes = grids(rng, (channels, height, width), cells)
    # In some of the grids, so that those of all kinds stand side by side.
    odd = planes[::2, 0]
    flipped = rng.random(odd.shape) < 0.2
    outer = np.ones((height, width), dtype=np.bool_)
    outer[1:-1, 1:-1] = False
    odd[flipped & ((inner & ~outer) | (border & outer))] -= 1
    planes[:, 0] = np.abs(planes[:, 0])
    crop = SparseEgocentricCrop((channels, height, width), radius)
    rows = crop(planes.astype(dtype))
    assert len(rows) == len(cells)
    assert crop.size == rows.dictionary.width
    np.testing.assert_array_equal(rows.dense().numpy(), slow_crop(planes, radius))


def test_views_of_an_empty_grid_are_one_atom_each() -> None:
    planes = grids(np.random.default_rng(0), (2, 6, 7), [(1, 1), (4, 5), (2, 3)])
    assert SparseEgocentricCrop((2, 6, 7), 5)(planes.astype(np.uint8)).choices.nnz == 3


@pytest.mark.parametrize("agents", [(1, 0), (1, 2), (2, 0)])
def test_one_agent_is_on_every_observation(agents: tuple[int, int]) -> None:
    planes = grids(np.random.default_rng(0), (3, 5, 5), [(1, 1), (2, 2)]).astype(np.uint8)
    planes[:, 1] = 0
    for grid, count in zip(planes, agents, strict=True):
        grid[1, 2, :count] = 1
    with pytest.raises(ValueError, match="there must be one on each"):
        SparseEgocentricCrop((3, 5, 5), 2)(planes)


@pytest.mark.parametrize("context", [fast_matmul(CPU), torch.autocast("cpu", torch.bfloat16)])
def test_half_precision_finds_the_agent_in_a_large_grid(context: torch.autocast) -> None:
    # bfloat16 knows 256 and 258, but no 257.
    shape = (3, 30, 40)
    cells = [(row, column) for row in range(1, 29) for column in range(1, 39)]
    planes = grids(np.random.default_rng(0), shape, cells)
    with context:
        cropped = EgocentricCrop(shape, 2)(torch.from_numpy(planes))
    np.testing.assert_array_equal(cropped.float().numpy(), slow_crop(planes, 2))


def test_planes_of_another_shape_are_refused() -> None:
    with pytest.raises(AssertionError, match=r"\(2, 3, 5, 6\)"):
        EgocentricCrop((3, 5, 5), 2)(torch.zeros(2, 3, 5, 6))
    with pytest.raises(AssertionError, match=r"\(2, 3, 5, 6\)"):
        SparseEgocentricCrop((3, 5, 5), 2)(np.zeros((2, 3, 5, 6), dtype=np.uint8))


def test_a_crop_is_no_part_of_a_file() -> None:
    assert EgocentricCrop((3, 5, 5), 2).state_dict() == {}

"""Sparse rows and their layer, against the matrices that they stand for."""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.sparse import (
    Choices,
    SparseLinear,
    SparseRows,
    Stock,
    Vectors,
    concatenate,
)

# Unit vectors of five inputs, then three vectors over the middle ones and two over the last.
STOCK = Stock(
    5,
    (
        Vectors(slice(0, 5)),
        Vectors(slice(1, 4), torch.tensor([[1.0, 2.0, 0.0], [0.0, 0.5, 1.0], [3.0, 0.0, -1.0]])),
        Vectors(slice(3, 5), torch.tensor([[0.1, 0.2], [-1.0, 1.0]])),
    ),
)
ALL_VECTORS = np.array(
    [
        *np.eye(5),
        [0, 1, 2, 0, 0],
        [0, 0, 0.5, 1, 0],
        [0, 3, 0, -1, 0],
        [0, 0, 0, 0.1, 0.2],
        [0, 0, 0, -1, 1],
    ],
    dtype=np.float32,
)
chosen_by_rows = st.lists(st.lists(st.integers(0, 9), max_size=6), min_size=1, max_size=12)


def sparse(chosen: list[list[int]]) -> SparseRows:
    """Rows that consist of these vectors, given in two pieces."""
    pieces = []
    for half in (slice(0, None, 2), slice(1, None, 2)):
        rows = [row for row, vectors in enumerate(chosen) for _ in vectors[half]]
        vectors = [vector for vectors in chosen for vector in vectors[half]]
        pieces.append(Choices(np.array(rows, dtype=np.int64), np.array(vectors, dtype=np.int64)))
    return SparseRows.of(pieces, len(chosen), STOCK)


def dense(chosen: list[list[int]]) -> torch.Tensor:
    return torch.from_numpy(np.array([ALL_VECTORS[vectors].sum(axis=0) for vectors in chosen]))


@given(chosen=chosen_by_rows)
def test_rows_are_sums_of_what_they_choose(chosen: list[list[int]]) -> None:
    rows = sparse(chosen)
    assert len(rows) == len(chosen)
    torch.testing.assert_close(rows.dense(), dense(chosen))


@given(chosen=chosen_by_rows, data=st.data())
def test_rows_are_taken_by_number_and_by_slice(chosen: list[list[int]], data: st.DataObject) -> None:
    numbers = data.draw(st.lists(st.integers(0, len(chosen) - 1), max_size=9))
    taken = sparse(chosen)[np.array(numbers, dtype=np.int64)]
    torch.testing.assert_close(taken.dense(), dense(chosen)[numbers])
    part = data.draw(st.slices(len(chosen)).filter(lambda part: (part.step or 1) > 0))
    torch.testing.assert_close(sparse(chosen)[part].dense(), dense(chosen)[part])


@given(parts=st.lists(chosen_by_rows, min_size=1, max_size=4))
def test_rows_are_put_below_each_other(parts: list[list[list[int]]]) -> None:
    together = concatenate([sparse(chosen) for chosen in parts])
    assert isinstance(together, SparseRows)
    torch.testing.assert_close(together.dense(), torch.cat([dense(chosen) for chosen in parts]))


def test_tensors_are_put_below_each_other() -> None:
    together = concatenate([torch.zeros(2, 3), torch.ones(1, 3)])
    assert isinstance(together, torch.Tensor)
    assert together.tolist() == [[0] * 3, [0] * 3, [1] * 3]


def test_rows_of_different_kinds_are_kept_apart() -> None:
    rows = sparse([[0], [1]])
    with pytest.raises(AssertionError, match="some rows are sparse"):
        concatenate([rows, torch.zeros(1, 5)])
    other = SparseRows(rows.chosen, rows.starts, Stock(5, STOCK.parts))
    with pytest.raises(AssertionError, match="different vectors"):
        concatenate([rows, other])


@given(chosen=chosen_by_rows, seed=st.integers(0, 99))
def test_a_layer_and_its_gradients_are_those_of_a_dense_one(chosen: list[list[int]], seed: int) -> None:
    torch.manual_seed(seed)
    layer = SparseLinear(5, 3)
    plain = nn.Linear(5, 3)
    plain.load_state_dict(layer.state_dict())
    weights = torch.randn(len(chosen), 3)
    results = []
    for outputs, parameters in (
        (layer(sparse(chosen)), layer.parameters()),
        (plain(dense(chosen)), plain.parameters()),
    ):
        (outputs.square() * weights).sum().backward()
        results.append([outputs, *(parameter.grad for parameter in parameters)])
    torch.testing.assert_close(results[0], results[1], atol=1e-4, rtol=1e-4)
    with torch.no_grad():
        torch.testing.assert_close(layer(sparse(chosen)), results[1][0], atol=1e-4, rtol=1e-4)


def fused_step(layer: SparseLinear) -> None:
    optimiser = EagerAdam(layer.parameters(), lr=0.1, fused=True)
    layer(sparse([[0, 5], [1, 9]])).sum().backward()
    optimiser.step()


def in_place(layer: SparseLinear) -> None:
    with torch.no_grad():
        layer.weight[0, 0] += 1


def replaced(layer: SparseLinear) -> None:
    layer.weight.data = layer.weight.data + 1


def loaded(layer: SparseLinear) -> None:
    layer.load_state_dict({name: value + 1 for name, value in layer.state_dict().items()})


@pytest.mark.parametrize("change", [fused_step, in_place, replaced, loaded])
def test_what_a_layer_keeps_follows_its_weights(change: Callable[[SparseLinear], None]) -> None:
    chosen = [[0, 5], [1, 8], [2, 3, 9]]
    torch.manual_seed(0)
    layer = SparseLinear(5, 3)
    twin = copy.deepcopy(layer)
    with torch.no_grad():
        before = layer(sparse(chosen))
    change(layer)
    with torch.no_grad():
        after = layer(sparse(chosen))
        torch.testing.assert_close(after, dense(chosen) @ layer.weight.T + layer.bias)
        assert (after != before).any()
        # Another stock is not mistaken for the known one, and a copy keeps nothing of the original's.
        rows, width = sparse([[0], [4]]), slice(0, 5)
        turned = Stock(5, (Vectors(width, torch.eye(5).flip(0)),))
        other = layer(SparseRows(rows.chosen, rows.starts, turned))
        torch.testing.assert_close(other, layer.weight.T[[4, 0]] + layer.bias)
        torch.testing.assert_close(copy.deepcopy(layer)(sparse(chosen)), after)
        torch.testing.assert_close(twin(sparse(chosen)), before)


def test_a_layer_takes_rows_of_its_width_only() -> None:
    with pytest.raises(AssertionError, match="rows of 5 inputs are not of 6"):
        SparseLinear(6, 2)(sparse([[0]]))


@pytest.mark.parametrize("grad", [True, False])
def test_a_layer_rounds_where_others_round(grad: bool) -> None:
    layer = SparseLinear(5, 3)
    with torch.set_grad_enabled(grad):
        assert layer(sparse([[0], [9]])).dtype == torch.float32
        with torch.autocast("cpu", torch.bfloat16):
            rounded = layer(sparse([[0], [9]]))
        assert rounded.dtype == torch.bfloat16
        assert torch.equal(rounded, layer(sparse([[0], [9]])).bfloat16())

"""Sparse rows and their layer, against the matrices that they stand for."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import nn

from moral_algorithms.networks.optimisers import EagerAdam
from moral_algorithms.networks.sparse import (
    Atoms,
    Dictionary,
    Entries,
    SparseLinear,
    SparseRows,
    concatenate,
)

# Unit vectors of five inputs, then three vectors over the middle ones and two over the last.
DICTIONARY = Dictionary(
    5,
    (
        Atoms(slice(0, 5)),
        Atoms(slice(1, 4), torch.tensor([[1.0, 2.0, 0.0], [0.0, 0.5, 1.0], [3.0, 0.0, -1.0]])),
        Atoms(slice(3, 5), torch.tensor([[0.1, 0.2], [-1.0, 1.0]])),
    ),
)
ATOMS = np.array(
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
atoms_of_rows = st.lists(st.lists(st.integers(0, 9), max_size=6), max_size=12)


def sparse(chosen: list[list[int]]) -> SparseRows:
    """Rows that consist of these vectors, given in two pieces."""
    pieces = []
    for half in (slice(0, None, 2), slice(1, None, 2)):
        rows = [row for row, vectors in enumerate(chosen) for _ in vectors[half]]
        vectors = [vector for vectors in chosen for vector in vectors[half]]
        pieces.append(Entries(np.array(rows, dtype=np.int64), np.array(vectors, dtype=np.int64)))
    return SparseRows.from_entries(pieces, len(chosen), DICTIONARY)


def dense(chosen: list[list[int]]) -> torch.Tensor:
    summed = [ATOMS[vectors].sum(axis=0) for vectors in chosen]
    return torch.from_numpy(np.array(summed, dtype=np.float32).reshape(-1, 5))


@given(chosen=atoms_of_rows)
def test_rows_are_sums_of_what_they_choose(chosen: list[list[int]]) -> None:
    rows = sparse(chosen)
    assert len(rows) == len(chosen)
    torch.testing.assert_close(rows.dense(), dense(chosen))


@given(chosen=atoms_of_rows, data=st.data())
def test_rows_are_taken_by_number_and_by_slice(chosen: list[list[int]], data: st.DataObject) -> None:
    any_row = st.integers(0, max(len(chosen) - 1, 0))
    numbers = data.draw(st.lists(any_row, max_size=9 if chosen else 0))
    taken = sparse(chosen)[np.array(numbers, dtype=np.int64)]
    torch.testing.assert_close(taken.dense(), dense(chosen)[numbers])
    part = data.draw(st.slices(len(chosen)).filter(lambda part: (part.step or 1) > 0))
    torch.testing.assert_close(sparse(chosen)[part].dense(), dense(chosen)[part])


@given(parts=st.lists(atoms_of_rows, min_size=1, max_size=4))
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
    other = SparseRows(rows.choices, Dictionary(5, DICTIONARY.parts))
    with pytest.raises(AssertionError, match="different dictionaries"):
        concatenate([rows, other])


@given(chosen=atoms_of_rows, seed=st.integers(0, 99))
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


def fused_step_without_bias(layer: SparseLinear) -> None:
    layer.bias.requires_grad_(False)
    optimiser = EagerAdam([layer.weight], lr=0.1, fused=True)
    layer(sparse([[0, 5], [1, 9]])).sum().backward()
    optimiser.step()


def in_place(layer: SparseLinear) -> None:
    with torch.no_grad():
        layer.weight[0, 0] += 1


def behind_the_scenes(layer: SparseLinear) -> None:
    layer.weight.data.mul_(3)


def as_an_array(layer: SparseLinear) -> None:
    layer.weight.detach().numpy()[1] *= 3


def replaced(layer: SparseLinear) -> None:
    layer.weight.data = layer.weight.data + 1


def loaded(layer: SparseLinear) -> None:
    layer.load_state_dict({name: value + 1 for name, value in layer.state_dict().items()})


def pickled(layer: SparseLinear) -> SparseLinear:
    read: SparseLinear = pickle.loads(pickle.dumps(layer))  # noqa: S301 - its own bytes
    return read


CHANGES = [
    *(fused_step, fused_step_without_bias, in_place, behind_the_scenes, as_an_array),
    *(replaced, loaded),
]


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])
def test_what_a_layer_keeps_follows_its_weights(
    change: Callable[[SparseLinear], None], copied: Callable[[SparseLinear], SparseLinear]
) -> None:
    chosen = [[0, 5], [1, 8], [2, 3, 9]]
    torch.manual_seed(0)
    layer = SparseLinear(5, 3)
    with torch.no_grad():
        before = layer(sparse(chosen))
    other = copied(layer)
    for changed in (layer, other):
        change(changed)
        with torch.no_grad():
            after = changed(sparse(chosen))
            torch.testing.assert_close(after, dense(chosen) @ changed.weight.T + changed.bias)
            assert (after != before).any()


def test_another_dictionary_is_not_mistaken_for_the_known_one() -> None:
    layer = SparseLinear(5, 3)
    rows, turned = sparse([[0], [4]]), Dictionary(5, (Atoms(slice(0, 5), torch.eye(5).flip(0)),))
    with torch.no_grad():
        torch.testing.assert_close(layer(rows), layer.weight.T[[0, 4]] + layer.bias)
        other = layer(SparseRows(rows.choices[:, :5], turned))
        torch.testing.assert_close(other, layer.weight.T[[4, 0]] + layer.bias)


def test_weights_made_for_inference_alone_are_applied() -> None:
    with torch.inference_mode():
        layer = SparseLinear(5, 3)
        expected = dense([[0, 9]]) @ layer.weight.T + layer.bias
        torch.testing.assert_close(layer(sparse([[0, 9]])), expected)


@pytest.mark.parametrize("frozen", ["weight", "bias"])
def test_a_part_of_a_layer_can_be_frozen(frozen: str) -> None:
    layer = SparseLinear(5, 3)
    getattr(layer, frozen).requires_grad_(False)
    layer(sparse([[0, 5], [1, 9]])).sum().backward()
    assert getattr(layer, frozen).grad is None
    learned = layer.bias if frozen == "weight" else layer.weight
    expected = {"weight": torch.full((3,), 2.0), "bias": dense([[0, 5], [1, 9]]).sum(dim=0).expand(3, 5)}
    assert learned.grad is not None
    torch.testing.assert_close(learned.grad, expected[frozen])


def test_gradients_are_added_up_in_full_precision() -> None:
    torch.manual_seed(0)
    chosen, gradients = [[0, 5], [1, 8], [2, 3, 9]], torch.randn(3, 4)
    layer = SparseLinear(5, 4)
    layer(sparse(chosen)).backward(gradients)
    full = layer.weight.grad
    layer.zero_grad()
    with torch.autocast("cpu", torch.bfloat16):
        layer(sparse(chosen)).backward(gradients.bfloat16())
    torch.testing.assert_close(layer.weight.grad, gradients.bfloat16().float().T @ dense(chosen))
    torch.testing.assert_close(full, gradients.T @ dense(chosen))


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

"""Linear layers on rows that are almost all zeros.

What an agent sees is hundreds of inputs, of which a dozen are ones, and walls that never change. The first
layer of a network then adds up a few columns of its weights instead of multiplying by zeros, which is faster.
Rows are compressed sparse rows over a dictionary: unit vectors, and what often comes together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, vstack  # type: ignore[import-untyped]
from torch import nn
from torch.nn import functional

from moral_algorithms.networks.stamps import Stamp, stamp

Index: TypeAlias = slice | NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Atoms:
    """Vectors that rows are sums of."""

    columns: slice
    """The inputs that they cover; all others are zero."""
    values: torch.Tensor | None = None
    """float32 of shape (m, inputs covered); None stands for the unit vectors of these inputs."""

    @property
    def count(self) -> int:
        """How many there are."""
        return self.columns.stop - self.columns.start if self.values is None else len(self.values)


@dataclass(frozen=True, eq=False)
class Dictionary:
    """All atoms that the rows of a matrix can be made of, numbered through."""

    width: int
    """Number of inputs."""
    parts: tuple[Atoms, ...]

    @property
    def count(self) -> int:
        """How many there are."""
        return sum(atoms.count for atoms in self.parts)


class Entries(NamedTuple):
    """Some atoms that some rows are made of."""

    rows: NDArray[np.integer[Any]]
    """Numbers of rows, ascending, shape (k,)."""
    atoms: NDArray[np.integer[Any]]
    """What is added to each, shape (k,)."""


class SparseRows:
    """A matrix (n, width) whose rows are sums of a few atoms.

    Parameters
    ----------
    choices
        SciPy's compressed sparse rows of shape (n, atoms): which atoms each row is made of. Where its
        entries are is all that counts.
    dictionary
        The atoms.
    """

    def __init__(self, choices: csr_array, dictionary: Dictionary) -> None:
        assert choices.shape[1] == dictionary.count, f"{choices.shape} is not (n, {dictionary.count})"
        self.choices = choices
        self.dictionary = dictionary

    @classmethod
    def from_entries(cls, entries: Sequence[Entries], count: int, dictionary: Dictionary) -> SparseRows:
        """Make ``count`` rows."""
        lengths = [np.bincount(rows, minlength=count) for rows, _ in entries]
        offsets = np.concatenate([[0], np.cumsum(np.sum(lengths, axis=0))])
        indices = np.empty(offsets[-1], dtype=np.int32)
        free = offsets[:-1].copy()
        for (rows, atoms), length in zip(entries, lengths, strict=True):
            indices[np.arange(len(rows)) + (free - np.cumsum(length) + length)[rows]] = atoms
            free += length
        ones = np.ones(len(indices), dtype=np.int8)
        return cls(csr_array((ones, indices, offsets), shape=(count, dictionary.count)), dictionary)

    def __len__(self) -> int:
        """Count the rows."""
        count: int = self.choices.shape[0]
        return count

    def __getitem__(self, index: Index) -> SparseRows:
        """Take the rows of a slice, or those of int64 numbers of shape (m,)."""
        return SparseRows(self.choices[index], self.dictionary)

    def dense(self) -> torch.Tensor:
        """Write the matrix out, as float32 of shape (n, width)."""
        return _sums(_project(self.dictionary, torch.eye(self.dictionary.width)), self.choices)


Rows: TypeAlias = SparseRows | torch.Tensor
"""Rows that can be taken by number, and put below each other: sparse ones, or a tensor of shape (n, ...)."""


def concatenate(parts: Sequence[Rows]) -> Rows:
    """Put rows below each other; sparse ones have their dictionary in common."""
    sparse = [part for part in parts if isinstance(part, SparseRows)]
    if not sparse:
        return torch.cat([part for part in parts if isinstance(part, torch.Tensor)])
    dictionary = sparse[0].dictionary
    assert len(sparse) == len(parts), "some rows are sparse and some are not"
    assert all(part.dictionary is dictionary for part in sparse), "rows are of different dictionaries"
    return SparseRows(vstack([part.choices for part in sparse], format="csr"), dictionary)


class SparseLinear(nn.Linear):
    """A linear layer on sparse rows; arguments as of :class:`torch.nn.Linear`.

    It adds up in float32; only the result is rounded where automatic casting is on, as that of other layers.
    """

    def __init__(self, in_features: int, out_features: int) -> None:
        super().__init__(in_features, out_features)
        self._projected: tuple[Dictionary, Stamp, torch.Tensor] | None = None

    def forward(self, rows: SparseRows) -> torch.Tensor:  # type: ignore[override]
        """Apply it, shape (n, outputs)."""
        width, kind = rows.dictionary.width, self.weight.device.type
        assert width == self.in_features, f"rows of {width} inputs are not of {self.in_features}"
        with torch.autocast(kind, enabled=False):
            if torch.is_grad_enabled():
                outputs: torch.Tensor = _Affine.apply(rows, self.weight, self.bias)  # type: ignore[no-untyped-call]
            else:
                outputs = _sums(self._project_once(rows.dictionary), rows.choices).add_(self.bias)
        return outputs.to(torch.get_autocast_dtype(kind)) if torch.is_autocast_enabled(kind) else outputs

    def _project_once(self, dictionary: Dictionary) -> torch.Tensor:
        """Apply the weights to a dictionary, which need not be done again before they change."""
        now, known = stamp(self), self._projected
        if known is None or known[0] is not dictionary or known[1] != now:
            known = self._projected = dictionary, now, _project(dictionary, self.weight)
        return known[2]

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be computed again; copies are made by this, too."""
        return {**self.__dict__, "_projected": None}


class _Affine(torch.autograd.Function):
    """Products of sparse rows and the transpose of weights (outputs, width), plus a bias."""

    @staticmethod
    def forward(ctx: Any, rows: SparseRows, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        ctx.rows, ctx.shape = rows, weight.shape
        return _sums(_project(rows.dictionary, weight), rows.choices).add_(bias)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        rows: SparseRows = ctx.rows
        of_weight, first = gradient.new_zeros(ctx.shape[::-1]), 0
        with torch.autocast(gradient.device.type, enabled=False):
            # What reaches an atom is the sum over the rows that contain it: the same again, by atoms.
            of_atoms = _sums(gradient.contiguous(), rows.choices.tocsc())
            for atoms in rows.dictionary.parts:
                part, values = of_atoms[first : first + atoms.count], atoms.values
                of_weight[atoms.columns] += part if values is None else values.to(part.device).T @ part
                first += atoms.count
        return None, of_weight.T, gradient.sum(dim=0)


def _project(dictionary: Dictionary, weight: torch.Tensor) -> torch.Tensor:
    """Multiply all atoms by the transpose of weights (outputs, width), shape (m, outputs)."""
    return torch.cat(
        [
            part.T if atoms.values is None else atoms.values.to(weight.device) @ part.T
            for atoms in dictionary.parts
            for part in [weight[:, atoms.columns]]
        ]
    )


def _sums(vectors: torch.Tensor, choices: csr_array | csc_array) -> torch.Tensor:
    """Add up those of vectors (m, size) that each row, or each column, has entries for, shape (n, size)."""
    device = vectors.device
    sums: torch.Tensor = functional.embedding_bag(
        torch.from_numpy(choices.indices).to(device),
        vectors,
        torch.from_numpy(choices.indptr).to(device),
        mode="sum",
        include_last_offset=True,
    )
    return sums

"""Linear layers on rows that are almost all zeros.

What an agent sees is hundreds of inputs, of which a dozen are ones, and walls that never change. The first
layer of a network then adds up a few columns of its weights instead of multiplying by zeros, which takes a
third of the time and does not round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.nn import functional

from moral_algorithms.networks.stamps import Stamp, stamp

Index: TypeAlias = slice | NDArray[np.int64]


@dataclass(frozen=True)
class Vectors:
    """Vectors that rows are sums of."""

    inputs: slice
    """The inputs that they cover; all others are zero."""
    values: torch.Tensor | None = None
    """float32 of shape (m, inputs covered); None stands for the unit vectors of these inputs."""

    @property
    def count(self) -> int:
        """How many there are."""
        return self.inputs.stop - self.inputs.start if self.values is None else len(self.values)


@dataclass(frozen=True)
class Stock:
    """All vectors that the rows of a matrix can be made of, numbered through."""

    width: int
    """Number of inputs."""
    parts: tuple[Vectors, ...]

    @property
    def count(self) -> int:
        """How many there are."""
        return sum(vectors.count for vectors in self.parts)


class Choices(NamedTuple):
    """Some vectors that some rows consist of."""

    rows: NDArray[np.integer[Any]]
    """Which rows, ascending, shape (k,)."""
    vectors: NDArray[np.integer[Any]]
    """What is added to each, shape (k,)."""


class SparseRows:
    """A matrix (n, width) whose rows are sums of a few vectors out of a common stock.

    Parameters
    ----------
    chosen
        int32 of shape (k,): numbers of vectors, row after row.
    starts
        int32 of shape (n + 1,): where in ``chosen`` each row begins, and k.
    stock
        The vectors.
    """

    def __init__(self, chosen: NDArray[np.int32], starts: NDArray[np.int32], stock: Stock) -> None:
        assert chosen.shape == (starts[-1],), f"{chosen.shape} is not ({starts[-1]},)"
        self.chosen = chosen
        self.starts = starts
        self.stock = stock

    @classmethod
    def of(cls, choices: Sequence[Choices], count: int, stock: Stock) -> SparseRows:
        """Make ``count`` rows."""
        lengths = [np.bincount(rows, minlength=count) for rows, _ in choices]
        starts = np.zeros(count + 1, dtype=np.int32)
        np.cumsum(sum(lengths), out=starts[1:])
        chosen = np.empty(starts[-1], dtype=np.int32)
        free = starts[:-1].astype(np.int64)
        for (rows, vectors), length in zip(choices, lengths, strict=True):
            chosen[np.arange(len(rows)) + (free - np.cumsum(length) + length)[rows]] = vectors
            free += length
        return cls(chosen, starts, stock)

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.starts) - 1

    def __getitem__(self, index: Index) -> SparseRows:
        """Take the rows of a slice, or those of int64 numbers of shape (m,)."""
        begins, lengths = self.starts[:-1][index], np.diff(self.starts)[index]
        starts = _starts(lengths)
        sources = np.arange(starts[-1]) + np.repeat(begins - starts[:-1], lengths)
        return SparseRows(self.chosen[sources], starts, self.stock)

    def dense(self) -> torch.Tensor:
        """Write the matrix out, as float32 of shape (n, width)."""
        return _sums(_apply(torch.eye(self.stock.width), self.stock), self.chosen, self.starts)


Rows: TypeAlias = SparseRows | torch.Tensor
"""Rows that can be taken by number, and put below each other: sparse ones, or a tensor of shape (n, ...)."""


def concatenate(parts: Sequence[Rows]) -> Rows:
    """Put rows below each other; sparse ones share their stock."""
    sparse = [part for part in parts if isinstance(part, SparseRows)]
    if not sparse:
        return torch.cat([part for part in parts if isinstance(part, torch.Tensor)])
    stock = sparse[0].stock
    assert len(sparse) == len(parts), "some rows are sparse and some are not"
    assert all(part.stock is stock for part in sparse), "rows are sums of different vectors"
    lengths = np.concatenate([np.diff(part.starts) for part in sparse])
    return SparseRows(np.concatenate([part.chosen for part in sparse]), _starts(lengths), stock)


class SparseLinear(nn.Linear):
    """A linear layer on sparse rows; arguments as of :class:`torch.nn.Linear`.

    It computes in float32. As other layers do, it gives half precision where automatic casting is on.
    """

    def __init__(self, in_features: int, out_features: int) -> None:
        super().__init__(in_features, out_features)
        self._last: tuple[Stock, Stamp, torch.Tensor] | None = None

    def forward(self, rows: SparseRows) -> torch.Tensor:  # type: ignore[override]
        """Apply it, shape (n, outputs)."""
        width, kind = rows.stock.width, self.weight.device.type
        assert width == self.in_features, f"rows of {width} inputs are not of {self.in_features}"
        with torch.autocast(kind, enabled=False):
            if torch.is_grad_enabled():
                outputs: torch.Tensor = _Affine.apply(rows, self.weight, self.bias)  # type: ignore[no-untyped-call]
            else:
                outputs = _sums(self._of_stock(rows.stock), rows.chosen, rows.starts).add_(self.bias)
        return outputs.to(torch.get_autocast_dtype(kind)) if torch.is_autocast_enabled(kind) else outputs

    def _of_stock(self, stock: Stock) -> torch.Tensor:
        """Apply the weights to a stock, which is done once for as long as they stay the same."""
        now = stamp(self)
        if self._last is None or self._last[0] is not stock or self._last[1] != now:
            self._last = stock, now, _apply(self.weight, stock)
        return self._last[2]


class _Affine(torch.autograd.Function):
    """Products of sparse rows and the transpose of weights (outputs, width), plus a bias."""

    @staticmethod
    def forward(ctx: Any, rows: SparseRows, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
        ctx.rows, ctx.shape = rows, weight.shape
        return _sums(_apply(weight, rows.stock), rows.chosen, rows.starts).add_(bias)

    @staticmethod
    def backward(ctx: Any, gradient: torch.Tensor) -> tuple[None, torch.Tensor, torch.Tensor]:
        rows, count = ctx.rows, ctx.rows.stock.count
        # What reaches a vector is the sum over the rows that chose it: the same again, by vectors.
        by_vector = np.argsort(rows.chosen.astype(_smallest(count)), kind="stable")
        choosing = np.repeat(np.arange(len(rows), dtype=np.int32), np.diff(rows.starts))[by_vector]
        starts = _starts(np.bincount(rows.chosen, minlength=count))
        of_vectors = _sums(gradient.contiguous(), choosing, starts)
        of_weight = gradient.new_zeros(ctx.shape[::-1])
        first = 0
        for vectors in rows.stock.parts:
            part = of_vectors[first : first + vectors.count]
            values = vectors.values
            of_weight[vectors.inputs] += part if values is None else values.to(part.device).T @ part
            first += vectors.count
        return None, of_weight.T, gradient.sum(dim=0)


def _apply(weight: torch.Tensor, stock: Stock) -> torch.Tensor:
    """Multiply all vectors of a stock by the transpose of weights (outputs, width), shape (m, outputs)."""
    return torch.cat(
        [
            part.T if vectors.values is None else vectors.values.to(weight.device) @ part.T
            for vectors in stock.parts
            for part in [weight[:, vectors.inputs]]
        ]
    )


def _sums(vectors: torch.Tensor, chosen: NDArray[np.int32], starts: NDArray[np.int32]) -> torch.Tensor:
    """Add up the chosen ones of vectors (m, size), shape (n, size)."""
    device = vectors.device
    sums: torch.Tensor = functional.embedding_bag(
        torch.from_numpy(chosen).to(device),
        vectors,
        torch.from_numpy(starts).to(device),
        mode="sum",
        include_last_offset=True,
    )
    return sums


def _starts(lengths: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    starts = np.zeros(len(lengths) + 1, dtype=np.int32)
    np.cumsum(lengths, out=starts[1:])
    return starts


def _smallest(count: int) -> type[np.unsignedinteger[Any]]:
    """Find a type for numbers below ``count``; NumPy sorts small ones many times faster."""
    return np.uint16 if count <= np.iinfo(np.uint16).max else np.uint32

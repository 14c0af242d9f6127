"""Adam for processes that compile nothing: it starts seconds sooner."""

from __future__ import annotations

from collections.abc import Callable
from inspect import unwrap
from typing import Any

import torch


class _Eager(torch.optim.Optimizer):
    """An optimiser whose methods do not import PyTorch's compiler.

    PyTorch wraps them so that they are left out of what is compiled. The wrappers import the compiler even
    where nothing ever is, which takes every process some three seconds.
    """

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        unwrap(torch.optim.Optimizer.add_param_group)(self, param_group)

    def zero_grad(self, set_to_none: bool = True) -> None:
        unwrap(torch.optim.Optimizer.zero_grad)(self, set_to_none)

    def state_dict(self) -> dict[str, Any]:
        state: dict[str, Any] = unwrap(torch.optim.Optimizer.state_dict)(self)
        return state

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        unwrap(torch.optim.Optimizer.load_state_dict)(self, state_dict)

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        loss: float | None = unwrap(torch.optim.Adam.step)(self, closure)
        return loss


class EagerAdam(_Eager, torch.optim.Adam):
    """:class:`torch.optim.Adam`, for a process that compiles nothing."""


class EagerAdamW(_Eager, torch.optim.AdamW):
    """:class:`torch.optim.AdamW`, for a process that compiles nothing."""

"""Whether a module's parameters are still what they were: for what is computed from them and kept."""

from __future__ import annotations

from typing import TypeAlias

from torch import nn

Stamp: TypeAlias = tuple[tuple[int, int, float], ...]


def stamp(module: nn.Module) -> Stamp:
    """Make something that is equal as long as no parameter changes.

    PyTorch counts the changes that it makes in place, but neither those of fused optimisers nor those made
    through ``data`` or NumPy. All but very special ones of these change the sum.
    """
    return tuple(
        (
            parameter.data_ptr(),
            0 if parameter.is_inference() else parameter._version,
            float(parameter.detach().sum()),
        )
        for parameter in module.parameters()
    )

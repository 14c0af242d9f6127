"""Whether a module's parameters are still what they were: for what is computed from them and kept."""

from __future__ import annotations

from typing import TypeAlias

from torch import nn

Stamp: TypeAlias = tuple[object, ...]


def stamp(module: nn.Module) -> Stamp:
    """Make something that is equal as long as no parameter changes.

    PyTorch counts the changes that it makes in place, but not those of fused optimisers. These change biases
    with everything else, and biases are small enough to be looked at.
    """
    parts: list[object] = []
    for parameter in module.parameters():
        parts += [parameter.data_ptr(), parameter._version]
        if parameter.dim() == 1:
            parts.append(parameter.detach().cpu().numpy().tobytes())
    return tuple(parts)

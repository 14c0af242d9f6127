"""Checks of the arrays that the yardsticks are given; a refusal is a ValueError of one line."""

from __future__ import annotations

import reprlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray


def require_numbers(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Return ``values`` as float64, or raise a ValueError if they are no array of numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {_brief(values)}; it must be an array of numbers") from None


def require_weights(weights: ArrayLike, components: Sequence[str]) -> NDArray[np.float64]:
    """Return scalarisation weights as float64 (k,), or raise a ValueError if they are none.

    They must be finite, nonnegative and not all zero, one for each of the k ``components``.
    """
    array = require_numbers("weights", weights)
    if array.shape != (len(components),):
        raise ValueError(f"weights has shape {array.shape}; it must have one for each of {components}")
    if not (np.isfinite(array).all() and (array >= 0).all() and array.any()):
        raise ValueError(f"weights is {array.tolist()}; it must be finite, nonnegative and not all zero")
    return array


def require_planes(starts: ArrayLike, num_planes: int) -> NDArray[np.uint8]:
    """Return starts as uint8 (n, num_planes, height, width), or raise a ValueError.

    They must be 0 and 1, and the first plane, that of the walls, must close the border.
    """
    try:
        planes = np.asarray(starts)
    except ValueError:
        raise ValueError(f"starts is {_brief(starts)}; it must be an array of 0 and 1") from None
    if planes.ndim != 4 or planes.shape[0] < 1 or planes.shape[1] != num_planes or min(planes.shape[2:]) < 3:
        raise ValueError(
            f"starts has shape {planes.shape}; it must be (n, {num_planes}, height, width), "
            "at least one start of at least 3 by 3 cells"
        )
    if planes.dtype.kind not in "biuf":
        raise ValueError(f"starts has dtype {planes.dtype}; it must be an array of 0 and 1")
    if not np.isin(planes, (0, 1)).all():
        raise ValueError(f"starts has values from {planes.min()} to {planes.max()}; it must have 0 and 1")
    planes = planes.astype(np.uint8)
    border = np.ones(planes.shape[2:], dtype=np.bool_)
    border[1:-1, 1:-1] = False
    refuse_first((planes[:, 0, border] == 0).any(axis=1), "a gap in its border", "walls all around")
    return planes


def refuse_first(wrong: NDArray[np.bool_], fault: str, right: str) -> None:
    """Raise a ValueError that names the first of the starts that is wrong, bool (n,), if there is one."""
    if wrong.any():
        raise ValueError(f"starts[{wrong.argmax()}] has {fault}; it must have {right}")


def _brief(value: object) -> str:
    """Show a value in one short line."""
    return " ".join(reprlib.repr(value).split())

"""Checks of arguments where they come in: the value in its plain Python type, or a ValueError of one line."""

from __future__ import annotations

import operator
from numbers import Real
from typing import SupportsFloat

import numpy as np

# In float32, which rewards are paid in.
_LARGEST = float(np.finfo(np.float32).max)


def as_integer(value: object) -> int | None:
    """Return the integer that something is; None if it is none, truth values among them."""
    if isinstance(value, (bool, np.bool_)):
        return None
    try:
        return operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        return None


def require_integer(argument: str, value: object, least: int, wanted: str) -> int:
    """Return an integer that does not lie below ``least``; ``wanted`` says in words what it must be."""
    number = as_integer(value)
    if number is None:
        raise ValueError(f"{argument} is {value!r}; it must be an integer, {wanted}")
    if number < least:
        raise ValueError(f"{argument} is {number}; it must be {wanted}")
    return number


def require_bool(argument: str, value: object) -> bool:
    """Return a truth value; nothing else counts as one."""
    if not isinstance(value, (bool, np.bool_)):
        raise ValueError(f"{argument} is {value!r}; it must be True or False")
    return bool(value)


def is_finite(value: object) -> bool:
    """Whether something is a number that float32 can hold, and no infinity."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    try:
        return abs(float(value)) <= _LARGEST
    except OverflowError:  # An integer that no float can hold.
        return False


def is_chance(value: object) -> bool:
    """Whether something is a number from 0 to 1."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, SupportsFloat):
        return False
    try:
        return 0 <= float(value) <= 1
    except (TypeError, ValueError):  # Arrays and NumPy's strings have the method, too.
        return False

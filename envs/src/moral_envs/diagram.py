"""Pictures of Noisy Constraint: its states with what they pay and cost, as text and as pixels."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

STATE_NAMES = ("S", "S1", "S2")

Pair = tuple[float, float]

_SAMPLES = 4
"""Samples of a pixel along each axis, for smooth edges."""

_INK, _WHITE, _PAPER, _BLUE = (38, 42, 50), (255, 255, 255), (245, 244, 240), (38, 88, 204)
_HEIGHT, _RADIUS, _LINE = 240, 36, 3
_CENTRES = ((60, 120), (230, 62), (230, 178))
"""Of the states' discs, in pixels from the left and from the top."""

# Five rows of three pixels, each an octal digit.
_GLYPHS = {
    **dict(zip("01234", ("75557", "26227", "71747", "71717", "55711"), strict=True)),
    **dict(zip("56789", ("74717", "74757", "71122", "75757", "75717"), strict=True)),
    **dict(zip(" .,-+", ("00000", "00002", "00024", "00700", "02720"), strict=True)),
    **dict(zip("e[]S", ("07647", "64446", "31113", "74717"), strict=True)),
}


def draw_ansi(rewards: Pair, costs: Pair, state: int) -> str:
    """Draw the states as text, the present one in brackets.

    Parameters
    ----------
    rewards, costs
        What S1 and S2 pay and cost.
    state
        Index of the present state in :data:`STATE_NAMES`.

    Returns
    -------
    str
        A line for each action.
    """
    padded = [name.ljust(2) for name in STATE_NAMES]
    names = [f"[{name}]" if number == state else f" {name} " for number, name in enumerate(padded)]
    lines = []
    for action, (reward, cost) in enumerate(zip(rewards, costs, strict=True)):
        start = names[0] if action == 0 else " " * len(names[0])
        lines.append(f"{start}-{action}->{names[1 + action]}  reward {reward:g}, cost {cost:g}")
    return "\n".join(lines)


def draw_rgb(rewards: Pair, costs: Pair, state: int) -> NDArray[np.uint8]:
    """Draw the states as an image, the present one dark.

    Parameters
    ----------
    rewards, costs, state
        As for :func:`draw_ansi`.

    Returns
    -------
    uint8 array of shape (240, width, 3)
        A fresh array, as wide as the numbers need.
    """
    return _image(rewards, costs, state).copy()


@lru_cache(maxsize=64)
def _image(rewards: Pair, costs: Pair, state: int) -> NDArray[np.uint8]:
    """Draw the image once for all: it is cached, and read-only for that reason."""
    texts = [f"[{reward:g}, {cost:g}]" for reward, cost in zip(rewards, costs, strict=True)]
    left = _CENTRES[1][0] + _RADIUS + 16
    size = (_HEIGHT, left + 16 * max(map(len, texts)) + 8)
    y, x = ((np.indices((size[0] * _SAMPLES, size[1] * _SAMPLES)) + 0.5) / _SAMPLES).astype(np.float32)
    samples = np.full((*x.shape, 3), _PAPER, dtype=np.uint8)
    start = np.array(_CENTRES[0])
    for centre in _CENTRES[1:]:
        way = (np.array(centre) - start) / np.hypot(*(np.array(centre) - start))
        tip = np.array(centre) - way * (_RADIUS + 4)
        ahead = (x - tip[0]) * way[0] + (y - tip[1]) * way[1]
        aside = abs((y - tip[1]) * way[0] - (x - tip[0]) * way[1])
        length = float((tip - start) @ way)
        samples[(aside < _LINE / 2) & (ahead > -length) & (ahead < -6)] = _INK
        samples[(ahead > -16) & (aside < -ahead / 2)] = _INK
    for number, centre in enumerate(_CENTRES):
        distance = np.hypot(x - centre[0], y - centre[1])
        samples[distance < _RADIUS] = _INK
        samples[distance < _RADIUS - _LINE] = _WHITE
        if number == state:
            samples[distance < _RADIUS - 2 * _LINE] = _BLUE
    shape = (size[0], _SAMPLES, size[1], _SAMPLES, 3)
    image: NDArray[np.uint8] = samples.reshape(shape).mean(axis=(1, 3)).round().astype(np.uint8)
    for number, (name, (column, row)) in enumerate(zip(STATE_NAMES, _CENTRES, strict=True)):
        ink = _WHITE if number == state else _INK
        _write(image, name, row - 12, column - 10 * len(name) + 2, 5, ink)
    for action, (text, (_, row)) in enumerate(zip(texts, _CENTRES[1:], strict=True)):
        _write(image, text, row - 10, left, 4, _INK)
        _write(image, str(action), 66 if action == 0 else 154, 128, 4, _INK)
    image.flags.writeable = False
    return image


def _write(
    image: NDArray[np.uint8], text: str, top: int, left: int, scale: int, colour: tuple[int, int, int]
) -> None:
    """Write a text of one line into an image, each of a character's pixels ``scale`` pixels wide."""
    for position, character in enumerate(text):
        rows = [[int(digit) >> bit & 1 for bit in (2, 1, 0)] for digit in _GLYPHS[character]]
        mask = np.kron(np.array(rows), np.ones((scale, scale), dtype=np.int64)) != 0
        x = left + 4 * scale * position
        image[top : top + len(mask), x : x + mask.shape[1]][mask] = colour

"""Draws the live session's page for the documentation: ``python tools/draw_live_pictures.py``.

The pictures are screenshots in the states that the tests bring about. Fonts and browsers differ, so no test
compares them; look at them when the page changes.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.chromium import chromium
from moral_envs import emergency_v0
from tests.algorithms.live import scenes
from tests.algorithms.live.stand_in import StandIn, serving

FOLDER = Path(__file__).parents[1] / "docs" / "pictures"

# Nothing moves by itself, so that every step is shown as it is.
_LAPTOP = {"viewport": {"width": 1280, "height": 720}, "reduced_motion": "reduce"}
_PHONE = {
    **_LAPTOP,
    "viewport": {"width": 390, "height": 844},
    "device_scale_factor": 1.5,
    "is_mobile": True,
    "has_touch": True,
}
_KEYS = ("ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight", " ", "w", "s", "a", "d")
# Milliseconds in which charts are drawn and fonts loaded.
_SETTLE = 800

Act = Callable[[Any, StandIn], None]


def press(*keys: str) -> Act:
    """Press keys, the next once the page has taken the one before."""

    def act(page: Any, _: StandIn) -> None:
        for key in keys:
            page.keyboard.press(key)
            page.wait_for_timeout(200)

    return act


def step(count: int) -> Act:
    """Show the state after so many steps."""
    return press("Home", *["."] * count)


def lose(page: Any, stand_in: StandIn) -> None:
    """Break the connection."""
    step(20)(page, stand_in)
    stand_in.hang_up(down=True)


def play(count: int) -> Act:
    """Play so many steps of a good episode."""
    return press(*(_KEYS[action] for action in scenes.solve(emergency_v0.world(), 0, ["people"])[:count]))


PICTURES: dict[str, tuple[Callable[[], StandIn], Act, dict[str, Any]]] = {
    "live_question": (scenes.emergency, step(14), _LAPTOP),
    "live_question_dark": (scenes.delivery, step(31), {**_LAPTOP, "color_scheme": "dark"}),
    "live_answered": (scenes.emergency, press("End", "ArrowRight"), _LAPTOP),
    "live_enough": (scenes.enough, press("End", "c"), _LAPTOP),
    "live_consent": (scenes.consent, press(), _LAPTOP),
    "live_waiting": (scenes.waiting, press(), _LAPTOP),
    "live_finished": (scenes.finished, press(), _LAPTOP),
    "live_disconnected": (scenes.emergency, lose, _LAPTOP),
    "live_demonstrate": (lambda: scenes.demonstrating(emergency_v0.world()), play(9), _LAPTOP),
    "live_phone": (scenes.emergency, step(14), _PHONE),
}
"""Name of each picture, the session it is of, what is done there, and on which device."""


def main() -> None:
    """Draw all of them."""
    with chromium() as browser:
        for name, (scene, act, device) in PICTURES.items():
            stand_in = scene()
            with serving(stand_in) as address:
                context = browser.new_context(**device)
                page = context.new_page()
                page.goto(address)
                page.wait_for_function("() => document.body.dataset.state !== 'connecting'")
                if scene not in (scenes.consent, scenes.waiting, scenes.finished):
                    page.wait_for_function("() => window.moral.drawn().left !== null")
                page.wait_for_timeout(_SETTLE)
                act(page, stand_in)
                page.wait_for_timeout(_SETTLE // 4)
                with Image.open(io.BytesIO(page.screenshot())) as picture:
                    # A palette is a third of the size.
                    picture.convert("RGB").quantize().save(FOLDER / f"{name}.png", optimize=True)
                context.close()


if __name__ == "__main__":
    main()

"""The pictures of the documentation are those that the worlds draw now."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from tools import draw_live_pictures, draw_pictures

PICTURES = draw_pictures.pictures()


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_up_to_date(name: str) -> None:
    with Image.open(draw_pictures.FOLDER / name) as picture:
        found = np.asarray(picture.convert("RGB"))
    message = f"docs/pictures/{name} is out of date: run tools/draw_pictures.py"
    np.testing.assert_array_equal(found, PICTURES[name], err_msg=message)


def test_there_are_no_other_pictures() -> None:
    found = {path.name for path in draw_pictures.FOLDER.iterdir()}
    live = {f"{name}.png" for name in draw_live_pictures.PICTURES}
    assert found == {*PICTURES, "play.png", *live}


def test_pictures_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in draw_pictures.FOLDER.iterdir()}
    assert max(sizes.values()) < 150_000, sizes

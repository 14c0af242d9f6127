"""A headless Chromium for the tests of the page; without one they are skipped."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from benchmarks.chromium import BrowserMissing, chromium

LAPTOP = {"width": 1280, "height": 720}
PHONE = {"width": 390, "height": 844}


@contextmanager
def browser_or_skip() -> Iterator[Any]:
    """Start the browser, or skip the test and say what is missing."""
    try:
        # A process less for each page to wait for.
        with chromium("--in-process-gpu") as browser:
            yield browser
    except BrowserMissing as missing:
        pytest.skip(str(missing))

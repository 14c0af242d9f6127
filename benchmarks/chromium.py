"""A headless Chromium that is installed on the system, driven by Playwright."""

from __future__ import annotations

import importlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
"""Commands under which a browser is looked for."""


class BrowserMissing(RuntimeError):
    """There is no browser, or nothing to drive it with; the message says what is missing."""


@contextmanager
def chromium(*options: str) -> Iterator[Any]:
    """Start the browser, and end it with the block.

    Parameters
    ----------
    *options
        Options of its command line.

    Yields
    ------
    playwright.sync_api.Browser

    Raises
    ------
    BrowserMissing
        If there is none.
    """
    try:
        api = importlib.import_module("playwright.sync_api")
    except ImportError as error:
        raise BrowserMissing("playwright is not installed: pip install playwright") from error
    path = next(filter(None, map(shutil.which, NAMES)), None)
    if path is None:
        raise BrowserMissing(f"no browser is installed: none of {', '.join(NAMES)}")
    with api.sync_playwright() as playwright:
        # Without its sandbox, for tests may run as root; the pages are the project's own.
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", *options])
        yield browser
        browser.close()

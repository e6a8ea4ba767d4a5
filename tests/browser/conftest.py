"""A browser for the tests of pages: the machine's own Chromium, or the one that playwright installed."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
MISSING = (
    "no browser is here: `sudo apt-get install chromium`, or `.venv/bin/playwright install --with-deps chromium`; "
    "the tests of pages need one"
)


def find_browser(own: str) -> str:
    """Path of a browser; fails where there is none."""
    for name in NAMES:
        found = shutil.which(name)
        if found is not None:
            return found
    if Path(own).exists():
        return own
    pytest.fail(MISSING)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless browser."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = find_browser(playwright.chromium.executable_path)
        opened = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield opened
        opened.close()

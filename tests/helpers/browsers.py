"""Pages in a browser without a window."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

OVERFLOW = "document.documentElement.scrollWidth - window.innerWidth"
"""By how much a page is wider than its window."""
PATIENCE_MS = 120_000  # A browser that takes longer for anything hangs
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_OPTIONS = [
    "--no-sandbox",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@contextmanager
def chromium() -> Iterator[Any]:
    """Chromium under Playwright; whoever asks for it is skipped where there is none."""
    sync_api = pytest.importorskip("playwright.sync_api")
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    with sync_api.sync_playwright() as playwright:
        if program is None and not Path(playwright.chromium.executable_path).exists():
            pytest.skip("there is no Chromium here")
        opened = playwright.chromium.launch(
            executable_path=program, args=_OPTIONS, timeout=PATIENCE_MS
        )
        yield opened
        opened.close()


def complaints(page: Any) -> list[str]:
    """Return the list of problems of a page from now on: errors, warnings, requests that fail."""
    said: list[str] = []
    page.on("console", lambda m: said.append(m.text) if _is_bad(m) else None)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("requestfailed", lambda request: said.append(f"failed: {request.url}"))
    return said


def requests(page: Any) -> list[str]:
    """Addresses that a page asks for from now on, but for what stands in the page itself."""
    asked: list[str] = []

    def note(request: Any) -> None:
        if not request.url.startswith(("data:", "blob:")):
            asked.append(request.url)

    page.on("request", note)
    return asked


def _is_bad(message: Any) -> bool:
    slow_drawing = ("willReadFrequently", "GPU stall", "GL Driver Message")
    bad = message.type in ("error", "warning")
    return bad and not any(text in message.text for text in slow_drawing)

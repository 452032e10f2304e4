"""A browser that is installed, for pages."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

__all__ = ["WIDTHS", "open_page", "started_browser"]

#: Widths of a window and of a phone, in pixels.
WIDTHS = (1280, 390)


@contextmanager
def started_browser() -> Iterator[Any]:
    """Start Chromium, or skip the test and say why."""
    playwright = pytest.importorskip("playwright.sync_api")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium is installed")
    with playwright.sync_playwright() as driver:
        # Its sandbox does not work for root, in containers for instance.
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@contextmanager
def open_page(browser: Any, file: Path, width: int) -> Iterator[Any]:
    """Open a file, and see that it asks nothing of the network and complains about nothing.

    Nothing may be wider than the screen either, but what scrolls by itself.
    """
    page = browser.new_page(viewport={"width": width, "height": 844})
    said: list[str] = []
    asked: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(file.as_uri())
    yield page
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert page.evaluate("document.documentElement.scrollWidth") == width
    page.close()

"""A studio in real Chromium, for what only a browser can show."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser without a window; skipped, by name, where there is none.

    Of one module: while it is there, an event loop runs in this thread, and modules without a browser begin loops of their own.
    """
    from tools.studio_server import CHROMIUM, GRAPHICS

    if not Path(CHROMIUM).is_file():
        pytest.skip(f"needs {CHROMIUM}")
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GRAPHICS)
        yield browser
        browser.close()


@pytest.fixture
def page(chromium: Any) -> Iterator[Any]:
    """A tab that must raise no error; what it waits for may take as long as a busy machine needs."""
    from tools.studio_server import PATIENCE_S, SIZES, cookies

    errors: list[str] = []
    tab = chromium.new_page(viewport=dict(zip(("width", "height"), SIZES[""], strict=True)))
    tab.context.add_cookies(cookies())
    tab.set_default_timeout(PATIENCE_S * 1e3)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    yield tab
    tab.close()
    assert errors == []

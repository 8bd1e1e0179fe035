"""What a browser makes of the rules: a token becomes a cookie, pages work, and a script in one reaches nothing elsewhere."""

import socket
from typing import Any

import pytest

from posefuse_studio import app
from posefuse_studio.access import Access
from posefuse_studio.pages import PAGES
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace
from tools.studio_server import TOKEN

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


def test_the_printed_address_opens_the_page_and_a_cookie_does_from_then_on(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    page.context.clear_cookies()
    base = lab[1]
    page.goto(f"{base}/live")
    page.get_by_text("a token is needed").wait_for()
    page.goto(f"{base}/live?token={TOKEN}")
    page.get_by_role("heading", name="Live", level=1).wait_for()
    assert page.url == f"{base}/live"
    page.goto(f"{base}/simulate")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()


def test_the_file_that_opens_the_browser_is_private_and_leads_to_the_page(
    page: Any, lab: tuple[StudioWorkspace, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    page.context.clear_cookies()
    studio = Studio(lab[0], Access.of("127.0.0.1", int(lab[1].rpartition(":")[2]), TOKEN))
    monkeypatch.setattr(app.webbrowser, "open", lambda address: True)
    with app._opening_page(studio):
        [file] = lab[0].root.rglob("open-*.html")
        assert file.stat().st_mode & 0o777 == 0o600
        page.goto(file.as_uri())
        page.get_by_role("heading", name="Cameras", level=1).wait_for()
    assert not file.exists()


def test_a_script_in_a_page_sends_nothing_elsewhere(page: Any, errors: list[str], lab: tuple[StudioWorkspace, str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(0.5)
        for one in PAGES:
            page.goto(lab[1] + one.path)
            page.get_by_role("heading", name=one.title, level=1).wait_for()
            blocked = page.evaluate(_SEND, f"http://127.0.0.1:{other.getsockname()[1]}")
            assert {"connect-src", "img-src", "script-src-elem"} <= set(blocked)
            with pytest.raises(TimeoutError):
                other.accept()
    # of the policy, which is what they are kept back by
    errors.clear()

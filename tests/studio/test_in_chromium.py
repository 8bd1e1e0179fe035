"""What only a browser can show, on a studio with a stand-in for a live session."""

import socket
from typing import Any

import pytest

from posefuse_studio import app
from posefuse_studio.access import Access
from posefuse_studio.pages import PAGES
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace
from tools.studio_server import TOKEN, stand_in

pytestmark = pytest.mark.slow


def drawn(page: Any, what: str) -> int:
    # the script that counts comes after the page
    page.wait_for_function("window.posefuseDrawn")
    return int(page.evaluate(f"window.posefuseDrawn.{what}"))


def drawn_more(page: Any, what: str, count: int) -> None:
    """Wait until so many more were drawn."""
    page.wait_for_function(f"window.posefuseDrawn.{what} > {drawn(page, what) + count}")


def test_a_second_session_is_listed_and_can_be_ended(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    with stand_in(lab[0].root, 1):
        page.goto(f"{lab[1]}/live")
        page.get_by_role("button", name="Jobs").click()
        sessions = page.locator(".pf-jobs .pf-job", has_text="Bench")
        page.wait_for_function("document.querySelectorAll('.pf-jobs .pf-job').length === 2")
        sessions.first.get_by_role("button", name="Cancel").click()
        page.wait_for_function("document.querySelectorAll('.pf-jobs .pf-job').length === 1")


def test_what_is_scrolled_out_of_the_window_is_not_drawn(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    page.set_viewport_size({"width": 1280, "height": 320})
    page.goto(f"{lab[1]}/live")
    drawn_more(page, "scene", 10)
    assert drawn(page, "tile") == 0
    page.locator(".pf-tile").last.scroll_into_view_if_needed()
    drawn_more(page, "tile", 5)
    before = drawn(page, "scene")
    drawn_more(page, "tile", 20)
    assert drawn(page, "scene") == before
    page.locator(".pf-scene").scroll_into_view_if_needed()
    drawn_more(page, "scene", 10)


def test_the_overlay_of_a_recording_is_switched_where_it_stands(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    page.goto(f"{lab[1]}/recordings?open=result")
    tile = page.locator(".pf-tile").first
    cameras = 3
    tile.wait_for()
    page.wait_for_function(f"window.posefuseDrawn.tile >= {cameras}")
    with_overlay = bytes(tile.screenshot())
    page.get_by_role("switch", name="Overlay").click()
    page.wait_for_function(f"window.posefuseDrawn.tile >= {2 * cameras}")
    assert bytes(tile.screenshot()) != with_overlay
    page.get_by_role("switch", name="Overlay").click()
    page.wait_for_function(f"window.posefuseDrawn.tile >= {3 * cameras}")
    assert bytes(tile.screenshot()) == with_overlay


# --- what a browser makes of the rules: a token becomes a cookie, pages work, and a script in one reaches nothing elsewhere


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

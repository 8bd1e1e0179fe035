"""What only a browser can show, on a studio with a stand-in for a live session: its pages, the rules of access, the keyboard."""

import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from posefuse_studio import app
from posefuse_studio.access import Access
from posefuse_studio.pages import PAGES
from posefuse_studio.pages.simulate import RoomMap
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace, write_stored
from tools.studio_server import PATIENCE_S, TOKEN, cookies, free_port, server, session_of, stand_in

pytestmark = pytest.mark.slow
Lab = tuple[StudioWorkspace, str]


def drawn(page: Any, what: str) -> int:
    # the script that counts comes after the page
    page.wait_for_function("window.posefuseDrawn")
    return int(page.evaluate(f"window.posefuseDrawn.{what}"))


def drawn_more(page: Any, what: str, count: int) -> None:
    """Wait until so many more were drawn."""
    page.wait_for_function(f"window.posefuseDrawn.{what} > {drawn(page, what) + count}")


def test_a_second_session_is_listed_and_can_be_ended(page: Any, lab: Lab) -> None:
    with stand_in(lab[0].root, 1):
        page.goto(f"{lab[1]}/live")
        page.get_by_role("button", name="Jobs").click()
        sessions = page.locator(".pf-jobs .pf-job", has_text="Bench")
        page.wait_for_function("document.querySelectorAll('.pf-jobs .pf-job').length === 2")
        sessions.first.get_by_role("button", name="Cancel").click()
        page.wait_for_function("document.querySelectorAll('.pf-jobs .pf-job').length === 1")


def test_what_is_scrolled_out_of_the_window_is_not_drawn(page: Any, lab: Lab) -> None:
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


def test_the_overlay_of_a_recording_is_switched_where_it_stands(page: Any, lab: Lab) -> None:
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


def test_a_session_survives_closed_tabs_a_lost_connection_and_another_server(chromium: Any, tmp_path: Path) -> None:
    port = free_port()

    def shown(tab: Any) -> None:
        tab.goto(f"http://127.0.0.1:{port}/live")
        drawn_more(tab, "messages", 20)
        assert session_of(tmp_path) == before

    def new_tab() -> Any:
        tab = chromium.new_page()
        tab.context.add_cookies(cookies())
        tab.set_default_timeout(PATIENCE_S * 1e3)
        return tab

    with ExitStack() as session:
        with server(tmp_path, port):
            session.enter_context(stand_in(tmp_path, 4))
            before = session_of(tmp_path)
            one, two = new_tab(), new_tab()
            shown(one)
            shown(two)
            one.close()
            shown(two)
            two.context.set_offline(True)
            two.wait_for_timeout(3000)
            two.context.set_offline(False)
            shown(two)
            two.close()
        with server(tmp_path, port):
            shown(new_tab())


# --- a token becomes a cookie, and a script in a page reaches nothing elsewhere


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


def test_the_printed_address_opens_the_page_and_a_cookie_does_from_then_on(page: Any, lab: Lab) -> None:
    page.context.clear_cookies()
    base = lab[1]
    page.goto(f"{base}/live")
    page.get_by_text("a token is needed").wait_for()
    page.goto(f"{base}/live?token={TOKEN}")
    page.get_by_role("heading", name="Live", level=1).wait_for()
    assert page.url == f"{base}/live"
    page.goto(f"{base}/simulate")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()


def test_the_map_of_a_plan_has_the_sides_of_its_room(page: Any, lab: Lab) -> None:
    open_page(page, f"{lab[1]}/simulate", ".pf-plan")
    for label, typed in (("room x, m", "5"), ("room y, m", "12")):
        page.get_by_label(label, exact=True).fill(typed)
    width, height = RoomMap((5.0, 12.0)).size_px
    page.locator(f'.pf-plan svg[viewBox="0 0 {width} {height}"]').first.wait_for()


def test_the_file_that_opens_the_browser_is_private_and_leads_to_the_page(
    page: Any, lab: Lab, monkeypatch: pytest.MonkeyPatch
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


def test_a_script_in_a_page_sends_nothing_elsewhere(page: Any, errors: list[str], lab: Lab) -> None:
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


# --- every control of every page by keyboard alone; and the sound of the next step


# pages, and what is shown when all of a page is there
CONTROLS_OF = {
    "/": ".pf-found",
    "/calibrate": ".pf-next",
    "/live": ".pf-tile",
    "/recordings": ".pf-recording-card",
    "/recordings?open=result": ".pf-clock:has-text(' s')",
    "/simulate": ".pf-plan",
}
_MOST_TABS, _MOST_ROUNDS = 150, 10
# what can be used; what is disabled or not shown need not be reached
_CONTROLS = """() => {
  const shown = (one) => one.getClientRects().length && getComputedStyle(one).visibility !== "hidden" && !one.closest("[inert]");
  const wanted = "a[href], button, input, select, textarea, [role=button], [role=checkbox], [role=switch], [role=slider], "
    + "[role=combobox], .q-btn, .q-checkbox, .q-toggle, .q-select, .cursor-pointer[role]";
  return [...document.querySelectorAll(wanted)].filter((one) => shown(one)
    && !one.closest(".disabled, [disabled], [aria-disabled=true], .q-field__append, .q-chip"));
}"""
_BEGIN = f"() => {{ window.controls = ({_CONTROLS})(); window.reached = new Set(); return window.controls.length; }}"
# the element with the focus, and whether that is seen, when its style has settled
_NOTE = """async () => {
  const now = document.activeElement;
  if (!now || now === document.body) return null;
  for (const one of window.controls) if (one === now || one.contains(now) || now.contains(one)) window.reached.add(one);
  const field = now.closest(".q-field")?.querySelector(".q-field__control");
  const places = [now, field].filter((one) => one);
  const changes = places.flatMap((one) => one.getAnimations()).filter((one) => one instanceof CSSTransition);
  await Promise.allSettled(changes.map((one) => one.finished));
  const drawn = (style) => style.outlineStyle === "solid" || style.boxShadow.includes("255, 179, 0");
  return { what: now.outerHTML.slice(0, 140), seen: places.some((one) => drawn(getComputedStyle(one))) };
}"""
# what was not reached; null where controls came or went meanwhile
_LEFT = f"""() => {{
  const now = ({_CONTROLS})(), before = window.controls;
  if (now.length !== before.length || now.some((one, i) => one !== before[i])) return null;
  return before.filter((one) => !window.reached.has(one)).map((one) => one.outerHTML.slice(0, 160));
}}"""
_COUNT = """
window.starts = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...rest) { window.starts++; return start.apply(this, rest); };
"""


def open_page(page: Any, address: str, shown: str) -> None:
    """Wait until it is connected and shows this."""
    page.add_init_script(_COUNT)
    page.goto(address)
    page.locator(shown).first.wait_for()
    page.wait_for_function("window.did_handshake")


def walked(page: Any) -> tuple[int, list[str], set[str]]:
    """Tab through all of a page: how many controls there are, which were not reached, and where the focus was not seen."""
    for _ in range(_MOST_ROUNDS):
        count, unseen = int(page.evaluate(_BEGIN)), set()
        for _ in range(_MOST_TABS):
            page.keyboard.press("Tab")
            now = page.evaluate(_NOTE)
            if now is not None and not now["seen"]:
                unseen.add(now["what"])
            if now is None and page.evaluate("window.reached.size") > 0:
                break
        left = page.evaluate(_LEFT)
        if left is not None:
            return count, left, unseen
    raise AssertionError(f"controls came or went in each of {_MOST_ROUNDS} rounds")


@pytest.mark.parametrize("path", CONTROLS_OF)
def test_tab_reaches_every_control_and_shows_where_it_is(page: Any, lab: Lab, path: str) -> None:
    open_page(page, lab[1] + path, CONTROLS_OF[path])
    count, left, unseen = walked(page)
    assert count > 5
    assert left == []
    assert unseen == set()


def test_the_phone_page_has_nothing_to_use(page: Any, lab: Lab) -> None:
    open_page(page, f"{lab[1]}/phone", ".pf-tile")
    assert page.evaluate(_BEGIN) == 0


def test_controls_are_used_by_space_and_enter(page: Any, lab: Lab) -> None:
    open_page(page, f"{lab[1]}/live", CONTROLS_OF["/live"])
    box = page.get_by_role("checkbox", name="Uncertainty")
    assert box.is_checked()
    box.focus()
    page.keyboard.press("Space")
    page.wait_for_function("document.activeElement.closest('[role=checkbox]').getAttribute('aria-checked') === 'false'")
    page.locator(".pf-nav").get_by_role("link", name="Simulate").focus()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()


def test_a_recording_is_played_by_arrows_and_space(page: Any, lab: Lab) -> None:
    path = "/recordings?open=result"
    open_page(page, lab[1] + path, CONTROLS_OF[path])
    timeline, clock = page.locator(".pf-timeline"), page.locator(".pf-clock")

    def shows(text: str) -> None:
        clock.filter(has_text=text).wait_for()

    timeline.focus()
    shows("0.000 s")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    shows("0.100 s")
    page.keyboard.press("ArrowLeft")
    shows("0.067 s")
    page.keyboard.press("End")
    shows("0.967 s")
    page.keyboard.press("Home")
    shows("0.000 s")
    top = page.evaluate("scrollY")
    page.keyboard.press("Space")
    shows("0.967 s")
    assert page.evaluate("scrollY") == top


def test_the_next_step_is_heard(page: Any, lab: Lab) -> None:
    workspace, base = lab
    open_page(page, f"{base}/calibrate", CONTROLS_OF["/calibrate"])
    page.get_by_text("Show the board to each camera").wait_for()
    assert page.evaluate("window.starts") == 0
    page.get_by_role("switch", name="Sound").focus()
    page.keyboard.press("Space")
    page.wait_for_function("window.starts === 2")
    # several times the page's own pace: nothing is said again
    page.wait_for_timeout(2500)
    assert page.evaluate("window.starts") == 2
    recording: Path = workspace.folder("calibrations/room/intrinsics-1")
    write_stored(recording / "coverage.json", {"target": "b.toml"})
    page.get_by_text("Calibrate the lenses").wait_for()
    page.wait_for_function("window.starts === 4")

"""Every control of every page by keyboard alone, in Chromium; and the sound of the next step."""

from pathlib import Path
from typing import Any

import pytest

from posefuse_studio.workspace import StudioWorkspace, write_stored

pytestmark = pytest.mark.slow
# pages, and what is shown when all of a page is there
PAGES = {
    "/": ".pf-found",
    "/calibrate": ".pf-lights",
    "/live": "[aria-label^='Name of person']",
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


@pytest.mark.parametrize("path", PAGES)
def test_tab_reaches_every_control_and_shows_where_it_is(page: Any, lab: tuple[StudioWorkspace, str], path: str) -> None:
    open_page(page, lab[1] + path, PAGES[path])
    count, left, unseen = walked(page)
    assert count > 5
    assert left == []
    assert unseen == set()


def test_the_phone_page_has_nothing_to_use(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    open_page(page, f"{lab[1]}/phone", ".pf-tile")
    assert page.evaluate(_BEGIN) == 0


def test_controls_are_used_by_space_and_enter(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    open_page(page, f"{lab[1]}/live", PAGES["/live"])
    box = page.get_by_role("checkbox", name="Uncertainty")
    assert box.is_checked()
    box.focus()
    page.keyboard.press("Space")
    page.wait_for_function("document.activeElement.closest('[role=checkbox]').getAttribute('aria-checked') === 'false'")
    page.locator(".pf-nav").get_by_role("link", name="Simulate").focus()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()


def test_a_recording_is_played_by_arrows_and_space(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    path = "/recordings?open=result"
    open_page(page, lab[1] + path, PAGES[path])
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


def test_the_next_step_is_heard(page: Any, lab: tuple[StudioWorkspace, str]) -> None:
    workspace, base = lab
    open_page(page, f"{base}/calibrate", PAGES["/calibrate"])
    page.get_by_text("Move the cube where two cameras see it").wait_for()
    assert page.evaluate("window.starts") == 0
    page.get_by_role("switch", name="Sound").focus()
    page.keyboard.press("Space")
    page.wait_for_function("window.starts === 2")
    # several times the page's own pace: nothing is said again
    page.wait_for_timeout(2500)
    assert page.evaluate("window.starts") == 2
    recording: Path = workspace.folder("calibrations/room/extrinsics-1")
    seen = {"cameras": ["cam00", "cam01"], "target": "a.toml"}
    write_stored(recording / "coverage.json", seen)
    page.get_by_text("Find where the cameras stand").wait_for()
    page.wait_for_function("window.starts === 4")

"""Every control of every page by keyboard alone, in Chromium; and the sound of the next step."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from small_session import saved_session

from posefuse.core import Rig
from posefuse.studio.calibrations import Project, save_project
from posefuse.studio.jobs import write_json
from posefuse.studio.setups import Setup, save_setup
from posefuse.studio.workspace import StudioWorkspace
from tools.studio_server import PATIENCE_S, free_port, server, stand_in

pytestmark = pytest.mark.slow
PAGES = ("/", "/calibrate", "/live", "/recordings", "/recordings?open=result", "/simulate", "/phone")
_MOST_TABS = 150
# what can be used; what is disabled or not shown need not be reached
_CONTROLS = """() => {
  const shown = (one) => one.getClientRects().length && getComputedStyle(one).visibility !== "hidden" && !one.closest("[inert]");
  const wanted = "a[href], button, input, select, textarea, [role=button], [role=checkbox], [role=switch], [role=slider], "
    + "[role=combobox], .q-btn, .q-checkbox, .q-toggle, .q-select, .cursor-pointer[role]";
  window.controls = [...document.querySelectorAll(wanted)].filter((one) => shown(one)
    && !one.closest(".disabled, [disabled], [aria-disabled=true], .q-field__append, .q-chip"));
  window.reached = new Set();
  return window.controls.length;
}"""
# the element with the focus, what it stands for, and whether the focus is seen
_NOTE = """() => {
  const now = document.activeElement;
  if (!now || now === document.body) return null;
  for (const one of window.controls) if (one === now || one.contains(now) || now.contains(one)) window.reached.add(one);
  const field = now.closest(".q-field")?.querySelector(".q-field__control");
  const drawn = (style) => style.outlineStyle === "solid" || style.boxShadow.includes("255, 179, 0");
  const seen = [now, field].some((one) => one && drawn(getComputedStyle(one)));
  return { what: now.outerHTML.slice(0, 140), seen };
}"""
_LEFT = "() => window.controls.filter((one) => !window.reached.has(one)).map((one) => one.outerHTML.slice(0, 160))"
_COUNT = """
window.starts = 0;
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...rest) { window.starts++; return start.apply(this, rest); };
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory, ring_rig: Callable[..., Rig]) -> Iterator[tuple[StudioWorkspace, str]]:
    """A workspace with a recording, a calibration that was begun and a live session, and the address of its studio."""
    workspace = StudioWorkspace(tmp_path_factory.mktemp("lab"))
    saved_session(workspace.root, ring_rig)
    videos = {f"cam0{c}": f"video:walk/videos/cam0{c}.mp4" for c in range(3)}
    save_setup(workspace, Setup(name="webcams", sources=videos))
    write_json(workspace.folder("targets") / "made.json", {})
    save_project(workspace, Project(name="room", setup="webcams", cube="a.toml", board="b.toml", lenses=False))
    port = free_port()
    with server(workspace.root, port), stand_in(workspace.root, 2):
        yield workspace, f"http://127.0.0.1:{port}"


def opened(chromium: Any, address: str) -> Any:
    page = chromium.new_page(viewport={"width": 1280, "height": 800})
    page.add_init_script(_COUNT)
    page.goto(address)
    page.wait_for_timeout(4000)
    return page


@pytest.mark.parametrize("path", PAGES)
def test_tab_reaches_every_control_and_shows_where_it_is(chromium: Any, lab: tuple[StudioWorkspace, str], path: str) -> None:
    page = opened(chromium, lab[1] + path)
    if "open=" in path:
        page.locator(".pf-timeline").wait_for(timeout=PATIENCE_S * 1e3)
        page.wait_for_timeout(3000)
    count = page.evaluate(_CONTROLS)
    unseen: set[str] = set()
    for _ in range(_MOST_TABS):
        page.keyboard.press("Tab")
        now = page.evaluate(_NOTE)
        if now is not None and not now["seen"]:
            unseen.add(now["what"])
        if now is None and page.evaluate("window.reached.size") > 0:
            break
    left = page.evaluate(_LEFT)
    page.close()
    assert count > (0 if path == "/phone" else 5) or path == "/phone"
    assert left == []
    assert unseen == set()


def test_controls_are_used_by_space_and_enter(chromium: Any, lab: tuple[StudioWorkspace, str]) -> None:
    page = opened(chromium, f"{lab[1]}/live")
    page.get_by_role("checkbox", name="Body").focus()
    page.keyboard.press("Space")
    page.wait_for_function("window.posefuseDrawn.bodies > 5", timeout=60_000)
    page.locator(".pf-nav").get_by_role("link", name="Simulate").focus()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="Simulate", level=1).wait_for()
    page.close()


def test_a_recording_is_played_by_arrows_and_space(chromium: Any, lab: tuple[StudioWorkspace, str]) -> None:
    page = opened(chromium, f"{lab[1]}/recordings?open=result")
    timeline, clock = page.locator(".pf-timeline"), page.locator(".pf-clock")
    timeline.wait_for(timeout=PATIENCE_S * 1e3)

    def shows(text: str) -> None:
        clock.filter(has_text=text).wait_for(timeout=20_000)

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
    page.close()


def test_the_next_step_is_heard(chromium: Any, lab: tuple[StudioWorkspace, str]) -> None:
    workspace, base = lab
    page = opened(chromium, f"{base}/calibrate")
    page.get_by_text("Move the cube where two cameras see it").wait_for()
    assert page.evaluate("window.starts") == 0
    page.get_by_role("switch", name="Sound").focus()
    page.keyboard.press("Space")
    page.wait_for_function("window.starts === 2", timeout=20_000)
    page.wait_for_timeout(2500)
    assert page.evaluate("window.starts") == 2
    recording: Path = workspace.folder("calibrations/room/extrinsics-1")
    write_json(recording / "coverage.json", {"cameras": ["cam00", "cam01"], "covered": [1, 1], "linked": [[1, 1], [1, 1]]})
    page.get_by_text("Find where the cameras stand").wait_for(timeout=20_000)
    page.wait_for_function("window.starts === 4", timeout=20_000)
    page.close()

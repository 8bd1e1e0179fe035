"""What only a browser can show, on a studio with a stand-in for a live session."""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from posefuse_studio.workspace import StudioWorkspace
from tools.studio_server import PATIENCE_S, cookies, free_port, server, session_of, stand_in

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

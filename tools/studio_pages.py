"""The studio in real Chromium: does a session survive tabs, connections and servers?

    python tools/studio_pages.py [--stand-in]

It plays the bundled clip in a temporary workspace, closes tabs, opens two, cuts the connection, and starts the server again. It
prints a line per trial, and ends with 1 where the session was not the same, a request went elsewhere or a page raised an error.
Needs Chromium (``--chromium PATH``) and the extra `dev`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

from playwright.sync_api import Page
from studio_server import CHROMIUM, PATIENCE_S, SIZES, Watched, free_port, in_chromium, server, session_of, stand_in, until


def start_session(watched: Watched) -> None:
    """Play the bundled clip, by the buttons of the page."""
    page = watched.page(path="/live")
    page.get_by_role("button", name="Start", exact=True).click()
    page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)


def survived(workspace: Path, watched: Watched) -> list[str]:
    """What a session is after closed tabs, two tabs, a cut connection and another server: a line per trial that failed."""
    failures, before = list[str](), session_of(workspace)

    def drawn(page: Page) -> bool:
        page.goto(f"{watched.base}/live")
        page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)
        first = page.evaluate("window.posefuseDrawn.messages")
        page.wait_for_timeout(4000)
        return bool(page.evaluate("window.posefuseDrawn.messages") > first)

    def check(what: str, good: bool) -> None:
        same = session_of(workspace) == before
        print(f"{'ok  ' if good and same else 'FAIL'}  {what}")
        if not (good and same):
            failures.append(what)

    one = watched.page()
    check("a page shows the session", drawn(one))
    two = watched.page(SIZES["_phone"])
    check("two tabs show it", drawn(two))
    one.close()
    check("one tab closed, the other continues", drawn(two))
    two.context.set_offline(True)
    two.wait_for_timeout(3000)
    two.context.set_offline(False)
    check("a connection that was lost comes back", drawn(two))
    two.close()
    return failures


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--chromium", default=CHROMIUM)
    parser.add_argument(
        "--stand-in", action="store_true", help="show the clip's exact truth instead of tracking: for a machine that is busy"
    )
    options = parser.parse_args()
    port = free_port()
    with tempfile.TemporaryDirectory() as place, in_chromium(port, options.chromium) as watched, ExitStack() as session:
        workspace = Path(place)
        with server(workspace, port):
            if options.stand_in:
                session.enter_context(stand_in(workspace, 4))
            else:
                start_session(watched)
            failures = survived(workspace, watched)
            before = session_of(workspace)
        with server(workspace, port):
            watched.page(path="/live").locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)
            if session_of(workspace) != before:
                failures.append("another server")
            print(f"{'ok  ' if 'another server' not in failures else 'FAIL'}  another server finds the session again")
            (workspace / ".posefuse-studio" / "jobs" / before[0] / "cancel").touch()
            until(lambda: not session_of(workspace)[0], "the session to end")
    print(watched.found())
    return int(bool(failures or watched.elsewhere or watched.errors))


if __name__ == "__main__":
    sys.exit(main())

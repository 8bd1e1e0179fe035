"""The studio in real Chromium: is every page served from here alone, and does a session survive tabs, connections and servers?

    python tools/studio_pages.py --pictures docs/images

It plays the bundled clip in a temporary workspace, opens every page at 1280x800 and 390x844, closes tabs, opens two, cuts the
connection, and starts the server again. It ends with 1 where a request went elsewhere, a page raised an error, or the session was
not the same.
Needs Chromium (``--chromium PATH``) and the extra `dev`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, Page, sync_playwright
from playwright.sync_api import Error as PlaywrightError
from studio_server import CHROMIUM, GRAPHICS, PATIENCE_S, SIZES, cookies, free_port, server, session_of, stand_in, until

_PERSON_MS = 30_000.0


class Watched:
    """Pages of one browser: what they asked for and what went wrong."""

    def __init__(self, browser: Browser, base: str) -> None:
        self._browser, self._base = browser, base
        self.requests = 0
        self.elsewhere: list[str] = []
        self.errors: list[str] = []

    def page(self, size: tuple[int, int]) -> Page:
        """A new tab."""
        page = self._browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.context.add_cookies(cookies())
        page.on("request", lambda request: self._asked(request.url))
        page.on("websocket", lambda socket: self._asked(socket.url.replace("ws://", "http://", 1)))
        page.on("response", lambda answer: self.errors.append(f"{answer.status} {answer.url}") if answer.status >= 500 else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        return page

    def _asked(self, url: str) -> None:
        self.requests += 1
        if not url.startswith((self._base, "data:", "blob:")):
            self.elsewhere.append(url)


def start_session(page: Page, base: str) -> None:
    """Play the bundled clip, by the buttons of the page."""
    page.goto(f"{base}/live")
    page.get_by_role("button", name="Start", exact=True).click()
    page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)


def survived(workspace: Path, port: int, watched: Watched) -> list[str]:
    """What a session is after closed tabs, two tabs, a cut connection and another server: a line per trial that failed."""
    base, failures, before = f"http://127.0.0.1:{port}", [], session_of(workspace)

    def drawn(page: Page) -> bool:
        page.goto(f"{base}/live")
        page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)
        first = page.evaluate("window.posefuseDrawn.messages")
        page.wait_for_timeout(4000)
        return bool(page.evaluate("window.posefuseDrawn.messages") > first)

    def check(what: str, good: bool) -> None:
        same = session_of(workspace) == before
        print(f"{'ok  ' if good and same else 'FAIL'}  {what}")
        if not (good and same):
            failures.append(what)

    one = watched.page(SIZES[""])
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


def pictures(watched: Watched, base: str, folder: Path | None, names: dict[str, str]) -> None:
    """Every page at both sizes; written to `folder` where it is given."""
    for suffix, size in SIZES.items():
        page = watched.page(size)
        for name, path in names.items():
            page.goto(f"{base}{path}")
            page.wait_for_timeout(5000)
            if path == "/live":
                # an image with a person in it; where the machine is too slow for one, it is taken all the same
                with contextlib.suppress(PlaywrightError):
                    page.locator(".pf-person").first.wait_for(state="visible", timeout=_PERSON_MS)
            if page.evaluate("document.documentElement.scrollWidth") > size[0]:
                watched.errors.append(f"{name}: wider than {size[0]} px")
            if folder is not None:
                page.screenshot(path=folder / f"studio_{name}{suffix}.png", animations="disabled")
        page.close()


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write screenshots here")
    parser.add_argument("--chromium", default=CHROMIUM)
    parser.add_argument(
        "--stand-in", action="store_true", help="show the clip's exact truth instead of tracking: for a machine that is busy"
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright, contextlib.ExitStack() as session:
        workspace, port = Path(place), free_port()
        base = f"http://127.0.0.1:{port}"
        browser = playwright.chromium.launch(executable_path=options.chromium, args=GRAPHICS)
        watched = Watched(browser, base)
        with server(workspace, port):
            if options.stand_in:
                session.enter_context(stand_in(workspace, 4))
            else:
                start_session(watched.page(SIZES[""]), base)
            failures = survived(workspace, port, watched)
            names = {"cameras": "/", "calibrate": "/calibrate", "live": "/live", "phone": "/phone"}
            pictures(watched, base, options.pictures, names)
            before = session_of(workspace)
        with server(workspace, port):
            page = watched.page(SIZES[""])
            page.goto(f"{base}/live")
            page.locator(".pf-tile").first.wait_for(timeout=PATIENCE_S * 1e3)
            if session_of(workspace) != before:
                failures.append("another server")
            print(f"{'ok  ' if 'another server' not in failures else 'FAIL'}  another server finds the session again")
            (workspace / ".posefuse-studio" / "jobs" / before[0] / "cancel").touch()
            until(lambda: not session_of(workspace)[0], "the session to end")
        browser.close()
    print(f"{watched.requests} requests, {len(watched.elsewhere)} elsewhere: {watched.elsewhere[:5]}")
    print(f"errors of pages: {watched.errors[:5]}")
    return int(bool(failures or watched.elsewhere or watched.errors))


if __name__ == "__main__":
    sys.exit(main())

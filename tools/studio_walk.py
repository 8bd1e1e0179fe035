"""The whole way through the studio in real Chromium, by clicking: from nothing to a verified rig, a live recording, its report.

    python tools/studio_walk.py --pictures out/walk --docs

The cameras are simulated: `tools/studio_walk.yaml`, a cube and a board that are moved before four cameras, is rendered first
(``--session DIR`` takes a rendered one); the person is the bundled clip, in which the same four cameras stand in the same places.
All videos are played at their own pace, again and again, as if they came from cameras.

It prints the time of each step, and counts requests to other hosts and errors of pages. It ends with 1 where there was one, or
where a step failed: at once with a job that fails, else after `_PATIENCE_S`.
Needs Chromium (``--chromium PATH``) and the extras `dev` and `sim`.
"""

from __future__ import annotations

import argparse
import json
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Error, Locator, Page
from studio_server import CHROMIUM, ROOT, SIZES, TOKEN, Watched, free_port, in_chromium, server

_MESSAGES = 500
# between two looks at whether a job has failed
_LOOK_MS = 2000.0
# a calibration on a machine that is busy takes less
_PATIENCE_S = 1800.0
_CAMERAS = ("cam00", "cam01", "cam02", "cam03")
_RECORD_S = 12.0
# until what came into the window has been drawn
_DRAWN_MS = 1000
_RIG = "calibrations/room/rig.toml"
# as in the scene
_TARGETS = {"Cube: square, mm": "270", "Board: squares across": "5", "down": "4", "square, mm": "190"}


# images of docs/studio.md, and what they show
_DOCS = {
    "studio_cameras": "cameras of targets",
    "studio_calibrate": "verification",
    "studio_live": "live while recording",
    "studio_phone_phone": "phone",
}


class Walk:
    """One visitor with one tab and a phone, a clock and a camera for screenshots."""

    def __init__(self, watched: Watched, pictures: Path | None, workspace: Path) -> None:
        self._watched, self._base, self._pictures = watched, watched.base, pictures
        self._jobs = workspace / ".posefuse-studio" / "jobs"
        self.page = self._tab("")
        self.took_s: dict[str, float] = {}

    @contextmanager
    def step(self, what: str) -> Iterator[None]:
        """Time it, and take an image of how it ended, also where it failed."""
        begun_s, good = time.monotonic(), False
        try:
            yield
            good = True
        finally:
            self.took_s[what] = time.monotonic() - begun_s
            print(f"{'ok  ' if good else 'FAIL'}  {self.took_s[what]:6.1f} s  {what}", flush=True)
            self.picture(f"{len(self.took_s):02d} {what}".replace(" ", "_"))

    def picture(self, name: str, page: Page | None = None) -> None:
        """A screenshot of this tab or another one, where images are wanted."""
        if self._pictures is not None:
            page = page or self.page
            size = page.viewport_size
            assert size is not None
            # in a window that holds all of it: what is outside of the window is not drawn
            for _ in range(2):  # a higher window may make the page higher, too
                height = max(size["height"], page.evaluate("document.documentElement.scrollHeight"))
                page.set_viewport_size({"width": size["width"], "height": height})
            page.wait_for_timeout(_DRAWN_MS)
            page.screenshot(path=self._pictures / f"{name}.png", animations="disabled")
            page.set_viewport_size(size)

    def open(self) -> None:
        """The first page, by the printed address, as the browser of a newcomer opens it."""
        self.page.context.clear_cookies()
        self.page.goto(f"{self._base}/?token={TOKEN}")

    def other_tab(self, path: str) -> None:
        """Close this tab and open another."""
        self.page.close()
        self.page = self._tab("", path)

    def phone(self) -> Page:
        """The phone page, in a tab of a phone's size."""
        return self._tab("_phone", "/phone")

    def _tab(self, size: str, path: str = "") -> Page:
        page = self._watched.page(SIZES[size], path)
        page.set_default_timeout(1e3 * _PATIENCE_S)
        return page

    def go(self, name: str) -> None:
        """Another page, by the navigation."""
        self.page.locator(".pf-nav").get_by_role("link", name=name).click()
        self.see(self.page.get_by_role("heading", name=name, level=1))

    def press(self, name: str) -> None:
        """A button, when it is there."""
        button = self.page.get_by_role("button", name=name, exact=True).first
        self.see(button)
        button.click()

    def fill(self, label: str, text: str) -> None:
        """A field."""
        field = self.page.get_by_label(label, exact=True)
        field.fill(text)
        field.blur()

    def choose(self, label: str, option: str) -> None:
        """An entry of a list."""
        self.page.get_by_label(label, exact=True).first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def see(self, what: str | Locator, *, gone: bool = False) -> None:
        """Wait until it is shown, or is not any more; raises AssertionError for what has failed."""
        place = self.page.get_by_text(what).first if isinstance(what, str) else what
        end_s = time.monotonic() + _PATIENCE_S
        while True:
            try:
                place.wait_for(state="hidden" if gone else "visible", timeout=_LOOK_MS)
                return
            except Error:
                self._check_jobs()
                if time.monotonic() > end_s:
                    raise AssertionError(f"for {_PATIENCE_S:g} s no {what}") from None

    def _check_jobs(self) -> None:
        """Raises AssertionError for one that has failed."""
        for file in self._jobs.glob("*/state.json"):
            state = json.loads(file.read_text(encoding="utf-8"))
            if state.get("state") == "failed":
                raise AssertionError(f"{file.parent.name}: {state['error']}")


def walk(way: Walk) -> None:
    """All of it."""
    _cameras(way, "targets", "targets", rig="")
    _calibrate(way)
    _cameras(way, "person", "person", rig=_RIG)
    _live(way)
    _report(way)


def _cameras(way: Walk, folder: str, preset: str, *, rig: str) -> None:
    with way.step(f"cameras of {preset}"):
        way.open() if not rig else way.go("Cameras")
        for camera in _CAMERAS:
            way.press(f"Add {folder}/{camera}.mp4")
        way.press("Show images")
        way.see(way.page.get_by_text("640x480").nth(len(_CAMERAS) - 1))
    with way.step(f"preset {preset}"):
        way.press("Save as preset")
        way.fill("Name of the preset", preset)
        if rig:
            way.choose("Rig file, if calibrated already", rig)
        way.press("Save")
        way.see(f"Saved as {preset}")


def _calibrate(way: Walk) -> None:
    with way.step("new calibration"):
        way.go("Calibrate")
        way.press("New calibration")
        way.press("Begin")
        way.see("Print a cube and a board")
    with way.step("targets to print"):
        way.press("Print targets")
        way.choose("Paper", "a0")
        for label, text in _TARGETS.items():
            way.fill(label, text)
        way.press("Make PDF files")
        way.see("Print at 100 %")
        way.picture("targets")
        way.press("Use these")
        way.see("Show the board to each camera")
    with way.step("the board is recorded for the lenses"):
        way.press("Start recording")
        way.see("Calibrate the lenses")
    with way.step("lenses"):
        way.press("Calibrate")
        way.see("Move the cube where two cameras see it")
    with way.step("the cube is recorded"):
        way.press("Start recording")
        way.see("Covered so far")
        way.page.wait_for_timeout(4000)
        way.picture("cube_while_recording")
        way.see("Find where the cameras stand")
    with way.step("positions"):
        way.press("Calibrate")
        way.see("Show the board to two cameras at once")
    with way.step("the board is recorded"):
        way.press("Start recording")
        way.see("Verify the rig")
    with way.step("verification"):
        way.press("Verify")
        way.see("The rig is verified")
    with way.step("the rig is used"):
        way.press("Use this rig")
        way.see("Start a session")


def _live(way: Walk) -> None:
    page = way.page
    with way.step("live session, until a person is seen in 3D"):
        way.go("Live")
        way.choose("Cameras", "person")
        way.press("Start")
        way.see(page.locator(".pf-person").first)
    with way.step("poses to another program"), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taker:
        taker.bind(("127.0.0.1", 9001))
        taker.settimeout(_PATIENCE_S)
        page.get_by_role("switch", name="JSON over UDP").click()
        # where the clip begins again no person is tracked for a moment
        if not any(b"left_knee" in taker.recv(65536) for _ in range(_MESSAGES)):
            raise AssertionError(f"no person in the first {_MESSAGES} messages")
        way.see("messages to")
        page.get_by_role("switch", name="JSON over UDP").click()
        way.see("messages to", gone=True)
    with way.step("the phone page, which is read-only"):
        phone = way.phone()
        way.see(phone.locator(".pf-person").first)
        way.see(phone.get_by_role("button").first, gone=True)
        way.picture("phone", phone)
        phone.close()
    with way.step(f"a recording of {_RECORD_S:.0f} s"):
        page.get_by_label("Name", exact=True).first.fill("walk")
        way.press("Record")
        way.see("● recordings/walk")
        way.other_tab("/live")
        way.see("● recordings/walk")
        way.page.wait_for_timeout(1e3 * _RECORD_S)
        way.picture("live_while_recording")
        way.press("Stop")
        way.see("● recordings/walk", gone=True)
    with way.step("the session ends"):
        way.press("End session")
        way.press("End it")
        way.see("Start a session")


def _report(way: Walk) -> None:
    page = way.page
    with way.step("the recording in the list"):
        way.go("Recordings")
        page.get_by_role("link", name="recordings/walk/recording.mcap", exact=True).click()
        way.see("Angles and gait events")
    with way.step("its angles"):
        way.see("left knee flexion")
    with way.step("its report"):
        way.press("Make the report")
        link = page.get_by_role("link", name="Open the page")
        way.see(link)
        with page.context.expect_page() as opened:
            link.click()
        opened.value.wait_for_load_state()
        way.picture("report", opened.value)
        if "left knee" not in opened.value.inner_text("body").lower().replace("_", " "):
            raise AssertionError("the report has no knee angles")


def cameras_of(workspace: Path, session: Path | None) -> None:
    """What stands for cameras: videos; a session of cube and board is rendered where none is given."""
    if session is None:
        session = workspace.with_name("session")
        scene = ROOT / "tools" / "studio_walk.yaml"
        subprocess.run([sys.executable, "-m", "posefuse", "simulate", str(scene), "--out", str(session)], check=True)
    for name, videos in (("targets", session / "videos"), ("person", ROOT / "examples" / "demo" / "videos")):
        shutil.copytree(videos, workspace / name)


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--session", type=Path, metavar="DIR", help="a rendered tools/studio_walk.yaml; one is made otherwise")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="write a screenshot of each step here")
    parser.add_argument("--docs", action="store_true", help="replace the pictures of docs/studio.md by those of this walk")
    parser.add_argument("--chromium", default=CHROMIUM)
    options = parser.parse_args()
    if options.pictures is not None:
        options.pictures.mkdir(parents=True, exist_ok=True)
    port, failed = free_port(), ""
    with tempfile.TemporaryDirectory() as place, in_chromium(port, options.chromium) as watched:
        workspace = Path(place) / "lab"
        workspace.mkdir()
        cameras_of(workspace, options.session)
        with server(workspace, port):
            way = Walk(watched, options.pictures, workspace)
            try:
                walk(way)
            except Exception as error:  # noqa: BLE001 - whatever ended the way is reported with its figures
                failed = str(error)
            finally:
                for folder in (workspace / ".posefuse-studio" / "jobs").glob("*"):
                    (folder / "cancel").touch()
    total_s = sum(way.took_s.values())
    print(f"{total_s:.0f} s in all; {watched.found()}")
    if failed:
        print(f"failed: {failed}")
    elif options.docs and options.pictures is not None:
        for name, what in _DOCS.items():
            picture = next(options.pictures.glob(f"*{what.replace(' ', '_')}.png"))
            shutil.copy(picture, ROOT / "docs" / "images" / f"{name}.png")
    return int(bool(failed or watched.elsewhere or watched.errors))


if __name__ == "__main__":
    sys.exit(main())

"""What the studio costs, in real Chromium:

    python bench/studio.py pages     # tiles and 3D per second, and the server's processor share with 0, 1 and 2 pages
    python bench/studio.py latency   # of a live session of the bundled clip, with no page and with one
    python bench/studio.py focus     # what the focus warning measures in the bundled clip, blurred by known amounts

`pages` draws from bench/studio_source.py, so that the detector does not compete with the browser for the machine. Chromium draws
on the processor here, where there is no graphics card: its rates are lower bounds.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from studio_pages import start_session
from studio_server import CHROMIUM, GRAPHICS, SIZES, free_port, server, session_of, stand_in, until

_CAMERAS, _SETTLE_S, _MEASURE_S = 8, 4.0, 15.0


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def opened(browser: Browser, base: str) -> Page:
    """A page that draws."""
    page = browser.new_page(viewport={"width": SIZES[""][0], "height": 2000})
    page.goto(f"{base}/live")
    page.locator(".pf-tile").first.wait_for(timeout=120_000)
    return page


def rates(pages: list[Page], pid: int, seconds: float) -> tuple[float, dict[str, float]]:
    """Processor share of the server, and what the first page draws per second."""
    before_s, begun = cpu_s(pid), time.monotonic()
    counts = pages[0].evaluate("({...window.posefuseDrawn})") if pages else {}
    if pages:
        pages[0].wait_for_timeout(seconds * 1000)
    else:
        time.sleep(seconds)
    elapsed = time.monotonic() - begun
    now = pages[0].evaluate("({...window.posefuseDrawn})") if pages else {}
    return (cpu_s(pid) - before_s) / elapsed, {name: (now[name] - counts[name]) / elapsed for name in now}


def measure_pages() -> None:
    """Table: pages open, server, per tile, 3D."""
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        workspace, port = Path(place), free_port()
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GRAPHICS)
        with stand_in(workspace, _CAMERAS), server(workspace, port) as studio:
            print(f"{_CAMERAS} cameras; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
            pages: list[Page] = []
            for count in (0, 1, 2):
                while len(pages) < count:
                    pages.append(opened(browser, f"http://127.0.0.1:{port}"))
                time.sleep(_SETTLE_S)
                share, drawn = rates(pages, studio.pid, _MEASURE_S)
                shown = {name: round(value / (_CAMERAS if name == "tile" else 1), 1) for name, value in drawn.items()}
                print(f"{count} pages: server {share:.1%} of a core; per second (one tile, 3D, all messages): {shown}")
        browser.close()


def measure_latency() -> None:
    """p95 from exposure to output without and with a page."""
    with tempfile.TemporaryDirectory() as place, sync_playwright() as playwright:
        workspace, port = Path(place), free_port()
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=GRAPHICS)
        with server(workspace, port):
            page = browser.new_page()
            start_session(page, f"http://127.0.0.1:{port}")
            figure = page.locator(".pf-figure").first
            # the figure is of the whole session so far: without a page first
            page.goto("about:blank")
            time.sleep(30.0)
            for what, seconds in (("no page", 0.0), ("one page", 30.0)):
                page.goto(f"http://127.0.0.1:{port}/live")
                figure.wait_for(timeout=60_000)
                page.wait_for_timeout(2000 + seconds * 1000)
                print(f"{what}: {figure.inner_text()} (95 %, since the session began; load {os.getloadavg()[0]:.1f})")
            (workspace / ".posefuse-studio" / "jobs" / session_of(workspace)[0] / "cancel").touch()
            until(lambda: not session_of(workspace)[0], "the session to end")
        browser.close()


def measure_focus() -> None:
    """Share of fine detail that a blur of a pixel leaves, per blur of the image."""
    import cv2

    from posefuse.formats.video import read_video
    from posefuse.pipeline.demo_clip import clip_folder
    from posefuse.studio.focus import detail_left

    images: list[Any] = [next(iter(read_video(path)))[1] for path in sorted((clip_folder() / "videos").glob("*.mp4"))]
    for blur_px in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0):
        left = [detail_left(cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image) for image in images]
        print(f"blurred by {blur_px:g} px: {min(left):.2f} to {max(left):.2f}")


if __name__ == "__main__":
    {"pages": measure_pages, "latency": measure_latency, "focus": measure_focus}[sys.argv[1]]()

"""What the studio costs:

    python bench/studio.py pages     # the server's processor share, and what pages get per second: none, one and two of them
    python bench/studio.py drawing   # frames per second in Chromium, and what each costs the page and the rasteriser
    python bench/studio.py latency   # of a live session of the bundled clip: without a page, and with one that draws nothing
    python bench/studio.py latency-browser   # the same, without a page and with one in Chromium
    python bench/studio.py focus     # what the focus warning measures in the bundled clip, blurred by known amounts

A page is either one that draws nothing (bench/studio_client.py), as if its browser were on another computer, or one in Chromium,
which draws WebGL on the processor where there is no graphics card, and takes that from the server and the session. `pages` draws
from bench/studio_source.py, so that no detector competes for the machine.

`latency` records one session and cuts it into windows without a page and with one, by turns. Latency is from mid-exposure
of the newest image to the first output that rests on it. What other programs do to the machine lasts longer than a window: so a
window with a page is compared with that without one in the same round.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, Page
from studio_client import QuietPage, quiet_page

from posefuse_ros.bags import read_poses
from posefuse_studio.jobs import Job, Jobs
from posefuse_studio.setups import DEMO
from posefuse_studio.workspace import StudioWorkspace

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from studio_server import PATIENCE_S, SIZES, TOKEN, Watched, free_port, in_chromium, server, stand_in, until

_CAMERAS, _SETTLE_S, _MEASURE_S, _ROUNDS, _STARTS = 8, 3.0, 12.0, 5, 3


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def drawing_page(watched: Watched, height_px: int = 2000, drawn: str = "tile > 0") -> Iterator[Page]:
    """A page in Chromium, when so much is drawn. All of the page is in a window that is so high."""
    page = watched.page((SIZES[""][0], height_px), "/live")
    page.wait_for_function(f"window.posefuseDrawn && window.posefuseDrawn.{drawn}", timeout=PATIENCE_S * 1e3)
    yield page
    page.close()


@contextmanager
def shown() -> Iterator[tuple[int, Watched]]:
    """A studio with a session that needs no detector: process of the server, and its pages in Chromium."""
    port = free_port()
    print(f"{_CAMERAS} cameras on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as place, ExitStack() as session:
        session.enter_context(stand_in(Path(place), _CAMERAS))
        studio = session.enter_context(server(Path(place), port))
        yield studio.pid, session.enter_context(in_chromium(port))


def counts_of(page: Page | QuietPage) -> Counter[str]:
    """What a page has received or drawn so far."""
    return page.counts() if isinstance(page, QuietPage) else Counter(page.evaluate("({...window.posefuseDrawn})"))


def rates(pages: Sequence[Page | QuietPage], pid: int) -> tuple[float, dict[str, float]]:
    """Processor share of the server, and what the first page gets per second; images and tiles: of one camera."""
    time.sleep(_SETTLE_S)
    before_s, begun, counts = cpu_s(pid), time.monotonic(), [counts_of(page) for page in pages]
    time.sleep(_MEASURE_S)
    elapsed_s, share = time.monotonic() - begun, (cpu_s(pid) - before_s) / (time.monotonic() - begun)
    got = counts_of(pages[0]) - counts[0] if pages else Counter()
    return share, {name: n / elapsed_s / (_CAMERAS if name in ("images", "tile") else 1) for name, n in got.items()}


def measure_pages() -> None:
    """A line per kind and number of pages."""
    with shown() as (pid, watched):
        quiet, drawing = (lambda: quiet_page(watched.base, TOKEN)), (lambda: drawing_page(watched))
        for kind, opening, numbers in (("page that draws nothing", quiet, (0, 1, 2)), ("page in Chromium", drawing, (1, 2))):
            for number in numbers:
                with ExitStack() as opened:
                    share, got = rates([opened.enter_context(opening()) for _ in range(number)], pid)
                parts = ", ".join(f"{name} {value:.1f}" for name, value in sorted(got.items()))
                print(f"{number} {kind}: server {share:.1%} of a core; per second: {parts} (load {load():.1f})", flush=True)


def measure_drawing() -> None:
    """A line per view: all of a page, a usual window, and the 3D view alone in sizes that cost the rasteriser more and less."""
    with shown() as (_, watched):
        for what, height_px, style in _VIEWS:
            with drawing_page(watched, height_px, "scene > 5") as page:
                if style:
                    page.add_style_tag(content=style)
                time.sleep(_SETTLE_S)
                print(f"{what}: {drawing_line(watched.browser, page)} (load {load():.1f})", flush=True)


def load() -> float:
    return os.getloadavg()[0]


_ALONE = ".pf-tile, .pf-plot { display: none }"
_SMALL = ".pf-stage, .pf-scene { min-height: 0 } .pf-stage { width: 200px; height: 150px }"
# all of the page is in the window where that is so high
_VIEWS = (
    ("all of the page", 2000, ""),
    ("a window of 1280 x 800", 800, ""),
    ("3D alone", 2000, _ALONE),
    ("3D alone, small", 2000, f"{_ALONE} {_SMALL}"),
)


def drawing_line(browser: Browser, page: Page) -> str:
    """What a page draws per second, and the processor time per frame of its script, its main thread and of other processes."""
    of_page, of_browser = page.context.new_cdp_session(page), browser.new_browser_cdp_session()
    # time of the thread itself: what it waits for a busy machine does not count
    of_page.send("Performance.enable", {"timeDomain": "threadTicks"})

    def spent() -> Counter[str]:
        found: Counter[str] = Counter(counts_of(page))
        for one in of_page.send("Performance.getMetrics")["metrics"]:
            found[one["name"]] += one["value"]
        for one in of_browser.send("SystemInfo.getProcessInfo")["processInfo"]:
            found[f"{one['type']} process"] += one["cpuTime"]
        return found

    before, begun_s = spent(), time.monotonic()
    time.sleep(_MEASURE_S)
    used, elapsed_s = spent() - before, time.monotonic() - begun_s
    wide, high = page.evaluate("(({width, height}) => [width, height])(document.querySelector('.pf-scene canvas'))")
    parts = {"script": "ScriptDuration", "main thread": "TaskDuration", "GPU process": "GPU process"}
    costs = ", ".join(f"{name} {1e3 * used[key] / max(used['scene'], 1):.1f}" for name, key in parts.items())
    frames, images = used["scene"] / elapsed_s, used["tile"] / elapsed_s / _CAMERAS
    return f"per second {frames:.1f} frames of {wide} x {high} px, {images:.1f} images per camera; ms per frame: {costs}"


def measure_latency(*, chromium: bool) -> None:
    """A line per window, then medians over the rounds; `chromium`: with a page that draws."""
    with tempfile.TemporaryDirectory() as place, ExitStack() as session:
        workspace, port = StudioWorkspace(Path(place)), free_port()
        jobs = Jobs(workspace)
        job = started(jobs)
        session.callback(jobs.cancel, job.id)
        session.enter_context(server(workspace.root, port))
        recorded(jobs, job)
        kinds: dict[str, Callable[[], AbstractContextManager[object]]] = {"no page": nullcontext}
        if chromium:
            watched = session.enter_context(in_chromium(port))
            kinds["page in Chromium"] = lambda: drawing_page(watched)
        else:
            kinds["page that draws nothing"] = lambda: quiet_page(f"http://127.0.0.1:{port}", TOKEN)
        windows: list[tuple[str, int, int]] = []
        for n in range(_ROUNDS):
            # neither is always the first
            for kind in list(kinds)[:: 1 if n % 2 else -1]:
                with kinds[kind]():
                    time.sleep(_SETTLE_S)
                    begun_ns = time.time_ns()
                    time.sleep(_MEASURE_S)
                    windows.append((kind, begun_ns, time.time_ns()))
                print(f"round {n + 1} of {_ROUNDS}: {kind}, load {load():.1f}", flush=True)
        jobs.cancel(job.id)
        until(lambda: jobs.report(job.id).ended, "the session to end")
        show_latencies(workspace.existing("recordings/latency/recording.mcap"), windows)


def started(jobs: Jobs) -> Job:
    """A session of the bundled clip, when it runs; the first one on a machine compiles, for longer than it may take to begin."""
    for _ in range(_STARTS):
        job = jobs.start("live", "Bench", {"setup": DEMO, "networks": "blazepose_lite"})
        until(lambda job=job: jobs.address(job.id) or jobs.report(job.id).ended, "the session")
        if not (report := jobs.report(job.id)).ended:
            return job
        print(f"the session did not begin: {report.state}: {report.error}", flush=True)
    raise RuntimeError(f"no session in {_STARTS} trials")


def recorded(jobs: Jobs, job: Job) -> None:
    """Have the session record its poses."""
    address = jobs.address(job.id)
    assert address is not None, "a session that listens"
    with Client(("127.0.0.1", address.port), authkey=address.key) as host:
        host.send_bytes(json.dumps(["record", {"name": "latency", "poses": True, "videos": False}]).encode())
        # its state: the request before is taken by then
        host.recv_bytes()


def show_latencies(recording: Path, windows: Sequence[tuple[str, int, int]]) -> None:
    """Median and 95 % of each window in ms, then what a page adds; a window without any output is left out with its pair."""
    stages = [(times["exposed"], times["output"]) for _, times in read_poses(recording) if "exposed" in times]
    exposed_ns, output_ns = np.array(stages, np.int64).reshape(-1, 2).T
    found: dict[str, list[tuple[float, ...]]] = defaultdict(list)
    for kind, begin_ns, end_ns in windows:
        ms = (output_ns - exposed_ns)[(output_ns >= begin_ns) & (output_ns < end_ns)] / 1e6
        median, most = np.percentile(ms, [50, 95]) if len(ms) else (np.nan, np.nan)
        found[kind].append((median, most))
        print(f"{kind}: median {median:.1f} ms, 95 % {most:.1f} ms of {len(ms)} outputs")
    with_page = next(kind for kind in found if kind != "no page")
    more = np.array(found[with_page]) - np.array(found["no page"])
    more = more[np.isfinite(more).all(axis=1)]
    for name, values in zip(("median", "95 %"), more.T, strict=True):
        spread = f"{np.median(values):+.1f} ms, {values.min():+.1f} to {values.max():+.1f}" if len(values) else "not known"
        print(f"{with_page} against no page, {name}, of {len(values)} pairs: {spread}")


def measure_focus() -> None:
    """Share of fine detail that a blur of a pixel leaves, per blur of the image."""
    import cv2

    from posefuse.formats.video import read_video
    from posefuse.pipeline.session import clip_folder
    from posefuse.realtime.watching import detail_left

    images: list[Any] = [next(iter(read_video(path)))[1] for path in sorted((clip_folder() / "videos").glob("*.mp4"))]
    for blur_px in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0):
        left = [detail_left(cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image) for image in images]
        print(f"blurred by {blur_px:g} px: {min(left):.2f} to {max(left):.2f}")


if __name__ == "__main__":
    {
        "pages": measure_pages,
        "drawing": measure_drawing,
        "latency": lambda: measure_latency(chromium=False),
        "latency-browser": lambda: measure_latency(chromium=True),
        "focus": measure_focus,
    }[sys.argv[1]]()

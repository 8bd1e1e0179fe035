"""What the studio costs, and what its focus warning measures:

    python bench/studio.py pages     # the server's processor share, and what pages get per second: none, one and two in Chromium
    python bench/studio.py focus     # what the focus warning measures in the bundled clip, blurred by known amounts

`pages` draws from bench/studio_source.py, so that no detector competes for the machine. Chromium draws WebGL on the processor
where there is no graphics card, and takes that from the server. Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import cv2
from harness import Row, answer, arguments
from playwright.sync_api import Page
from studio_server import PATIENCE_S, SIZES, Watched, free_port, in_chromium, server, stand_in

from posefuse.formats.video import read_video
from posefuse.pipeline.session import clip_folder
from posefuse.realtime.watching import detail_left

_CAMERAS, _SETTLE_S, _MEASURE_S, _PAGES = 8, 3.0, 12.0, 2
# all of a page is in a window that is so high
_HIGH_PX = 2000
_BLURS_PX = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def drawing_page(watched: Watched) -> Iterator[Page]:
    """A live page, when it has drawn an image."""
    page = watched.page((SIZES[""][0], _HIGH_PX), "/live")
    page.wait_for_function("window.posefuseDrawn && window.posefuseDrawn.tile > 0", timeout=PATIENCE_S * 1e3)
    yield page
    page.close()


def rates(pages: Sequence[Page], pid: int) -> Row:
    """Processor share of the server, and what the first page gets and draws per second; tiles: of one camera."""

    def counted() -> Counter[str]:
        return Counter(pages[0].evaluate("({...window.posefuseDrawn})") if pages else {})

    time.sleep(_SETTLE_S)
    before_s, begun_s, before = cpu_s(pid), time.monotonic(), counted()
    time.sleep(_MEASURE_S)
    elapsed_s = time.monotonic() - begun_s
    got = {name: n / elapsed_s / (_CAMERAS if name == "tile" else 1) for name, n in (counted() - before).items()}
    return {"pages": len(pages), "server, of a core": (cpu_s(pid) - before_s) / elapsed_s, "load": os.getloadavg()[0], **got}


def pages() -> dict[str, list[Row]]:
    port, rows = free_port(), []
    with tempfile.TemporaryDirectory() as place, ExitStack() as session:
        session.enter_context(stand_in(Path(place), _CAMERAS))
        studio = session.enter_context(server(Path(place), port))
        watched = session.enter_context(in_chromium(port))
        for number in range(_PAGES + 1):
            with ExitStack() as opened:
                rows.append(rates([opened.enter_context(drawing_page(watched)) for _ in range(number)], studio.pid))
    return {f"Pages of {_CAMERAS} cameras on {os.cpu_count()} cores, per second": rows}


def focus() -> dict[str, list[Row]]:
    """Share of fine detail that a blur of a pixel leaves, per blur of the image."""
    images, rows = [next(iter(read_video(path)))[1] for path in sorted((clip_folder() / "videos").glob("*.mp4"))], []
    for blur_px in _BLURS_PX:
        left = [detail_left(cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image) for image in images]
        rows.append({"blurred by, px": blur_px, "least": min(left), "most": max(left)})
    return {"Detail left": rows}


def main() -> None:
    args = arguments(__doc__, positional=("step",), step=str)
    steps = {step.__name__: step for step in (pages, focus)}
    if args.step not in steps:
        raise SystemExit(f"{args.step}: expected one of {', '.join(steps)}")
    answer(args, steps[args.step]())


if __name__ == "__main__":
    main()

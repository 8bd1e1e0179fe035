"""Take the pictures of the studio's recordings: python docs/make_studio_pictures.py [RESULT]. Needs Chromium and playwright.

RESULT is a result of `posefuse track examples/demo`; left out, the first seconds of the bundled clip are tracked. The pages
Recordings (the list, and one recording) and Simulate are opened at 1280 x 800 and at 390 x 844. A request to another host, an
error on a page, or a page that is wider than the window ends the command with exit code 1.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

import cv2

import posefuse

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tools"))

from studio_server import ROOT, SIZES, Watched, free_port, in_chromium, server

_IMAGES = ROOT / "docs" / "images"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_RECORDING = "results/demo"
_PAGES = {"recordings": "/recordings", "recording": f"/recordings?open={_RECORDING}", "simulate": "/simulate"}
# a page has drawn everything after so long, also on a busy machine; that of a recording works out angles first
_SETTLED_MS, _ANGLES_MS = 6_000, 400_000
# that of a recording is shown with its angles, below the videos
_TALL_PX = 1340


def main() -> None:
    """All pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", nargs="?", type=Path)
    args = parser.parse_args()
    executable = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if executable is None:
        raise SystemExit(f"no browser: expected one of {', '.join(_BROWSERS)}")
    with tempfile.TemporaryDirectory() as folder:
        workspace = filled_workspace(Path(folder), args.result)
        port = free_port()
        with server(workspace, port), in_chromium(port, executable) as watched:
            for ending, size_wh in SIZES.items():
                photograph(watched, ending, size_wh)
    print(watched.found())
    raise SystemExit(bool(watched.elsewhere or watched.errors))


def filled_workspace(folder: Path, result: Path | None) -> Path:
    """The bundled session and its result, as the studio keeps them."""
    shutil.copytree(ROOT / "examples" / "demo", folder / "sessions" / "demo")
    if result is not None:
        shutil.copytree(result, folder / _RECORDING)
    else:
        posefuse.track(folder / "sessions" / "demo", end_s=4.0, out=folder / _RECORDING, progress=True)
    return folder


def photograph(watched: Watched, ending: str, size_wh: tuple[int, int]) -> None:
    """Pictures of all pages in a window of this size."""
    for name, address in _PAGES.items():
        page = watched.page(size_wh, address)
        if name == "recording":
            page.get_by_text("left knee flexion").first.wait_for(timeout=_ANGLES_MS)
        page.wait_for_timeout(_SETTLED_MS)
        if name == "recording" and not ending:
            page.set_viewport_size({"width": size_wh[0], "height": _TALL_PX})
            page.wait_for_timeout(_SETTLED_MS)
        path = _IMAGES / f"studio_{name}{ending}.png"
        if page.evaluate("document.documentElement.scrollWidth") > size_wh[0]:
            watched.errors.append(f"{name}: wider than {size_wh[0]} px")
        page.screenshot(path=path, animations="disabled")
        image = cv2.imread(str(path))
        cv2.imwrite(str(path), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        print(path.name, f"{path.stat().st_size // 1024} kB")
        page.close()


if __name__ == "__main__":
    main()

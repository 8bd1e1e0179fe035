"""Take the pictures of the report: python docs/make_report_pictures.py [RESULT]. Needs Chromium.

RESULT is a folder of `posefuse track`; left out, the bundled clip is tracked first.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from pathlib import Path

import cv2

import posefuse

_ROOT = Path(__file__).resolve().parents[1]
_IMAGES = _ROOT / "docs" / "images"
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_SECONDS = 60
# a phone's width is given to a frame: a headless window is never that narrow
_PHONE = '<body style="margin:0"><iframe src="{page}" style="border:0;width:390px;height:{height}px"></iframe>'
_DARK = ("--blink-settings=preferredColorScheme=0",)


def photograph(page: Path, name: str, size_wh: tuple[int, int], top_px: int, flags: tuple[str, ...] = ()) -> None:
    """A PNG of the page below `top_px`, in a window of this size."""
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        raise SystemExit(f"no browser: expected one of {', '.join(_BROWSERS)}")
    path = _IMAGES / f"{name}.png"
    shared = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--allow-file-access-from-files")
    window = (f"--window-size={size_wh[0]},{size_wh[1]}", f"--screenshot={path}", "--virtual-time-budget=10000")
    subprocess.run([browser, *shared, *window, *flags, page.as_uri()], check=True, capture_output=True, timeout=_SECONDS)
    image = cv2.imread(str(path))
    cv2.imwrite(str(path), image[top_px:], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    print(path.name, f"{path.stat().st_size // 1024} kB")


def main() -> None:
    """All pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("result", nargs="?", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        recording = posefuse.read(args.result) if args.result else posefuse.track(_ROOT / "examples" / "demo", progress=True)
        page = next(one for one in recording.report(Path(folder) / "report") if one.suffix == ".html")
        phone = Path(folder) / "phone.html"
        phone.write_text(_PHONE.format(page=page.as_uri(), height=1500), encoding="utf-8")
        photograph(page, "report_top", (1280, 1560), 0)
        photograph(page, "report_gait_cycle", (1280, 2900), 1560)
        photograph(page, "report_dark", (1280, 1560), 0, _DARK)
        photograph(phone, "report_phone", (390, 1500), 0)


if __name__ == "__main__":
    main()

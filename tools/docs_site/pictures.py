"""Images of the documentation: what the gallery scripts draw, and the moving image of the README.

python -m tools.docs_site.pictures          all
python -m tools.docs_site.pictures moving   only the moving image
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

import posefuse as pf
from posefuse.outputs.drawing import grid_for, view_tile
from posefuse.outputs.overview import stage_picture
from posefuse.sources import Seeker, VideoConfig, nearest

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
CLIP, SCRIPTS = ROOT / "examples" / "demo", ROOT / "examples" / "gallery"
START_S, SECONDS = 3.0, 4.0
# every n-th time step of 15 per second is drawn
STEP = 1
VIEWS_WH, STAGE_WIDTH = (480, 360), 400
MOST_BYTES = 2_000_000


def gallery_pictures() -> None:
    """Run the scripts that draw."""
    out = IMAGES / "gallery"
    out.mkdir(exist_ok=True)
    for name in ("knee_angle", "uncertainty"):
        runpy.run_path(str(SCRIPTS / f"{name}.py"))["main"](CLIP, out)
    runpy.run_path(str(SCRIPTS / "plan_rig.py"))["main"](out)


def moving_picture() -> Path:
    """The bundled clip as an animated WebP: the four views with the skeleton, and the scene in 3D."""
    recording = pf.track(CLIP, start_s=START_S, end_s=START_S + SECONDS)
    path = IMAGES / "demo.webp"
    frames = [Image.fromarray(picture) for picture in _pictures(recording)]
    period_ms = round(1000 * STEP / recording.rate_hz)
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=period_ms, loop=0, quality=45, method=6)
    if path.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{path}: {path.stat().st_size} bytes, expected at most {MOST_BYTES}: draw fewer or smaller frames")
    return path


def _pictures(recording: pf.Recording) -> Iterator[np.ndarray]:
    grid = grid_for([camera.size_wh for camera in recording.rig], VIEWS_WH)
    width, height = grid.size_wh
    videos = [Seeker(VideoConfig(CLIP / "videos" / f"{name}.mp4", name).build()) for name in recording.rig.names]
    for i in range(0, len(recording.poses), STEP):
        picture = np.zeros((height, width + STAGE_WIDTH, 3), np.uint8)
        for c, video in enumerate(videos):
            image = video.at(nearest(video.times_ns, int(recording.poses.t_ns[i]))).image
            left, top = grid.corner(c)
            picture[top : top + grid.tile_wh[1], left : left + grid.tile_wh[0]] = view_tile(recording, i, c, image, grid.tile_wh)
        picture[:, width:] = stage_picture(recording, i, (STAGE_WIDTH, height))
        yield picture


if __name__ == "__main__":
    print(moving_picture())
    if sys.argv[1:] != ["moving"]:
        gallery_pictures()

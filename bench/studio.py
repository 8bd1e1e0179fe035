"""What the focus warning of the studio measures in the bundled clip, blurred by known amounts.

    python bench/studio.py

A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import cv2
from harness import answer, arguments

from posefuse.formats.video import read_video
from posefuse.pipeline.session import clip_folder
from posefuse.realtime.watching import detail_left

_BLURS_PX = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0)


def main() -> None:
    """Share of fine detail that a blur of a pixel leaves, per blur of the image."""
    args = arguments(__doc__)
    images, rows = [next(iter(read_video(path)))[1] for path in sorted((clip_folder() / "videos").glob("*.mp4"))], []
    for blur_px in _BLURS_PX:
        left = [detail_left(cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image) for image in images]
        rows.append({"blurred by, px": blur_px, "least": min(left), "most": max(left)})
    answer(args, {"Detail left": rows})


if __name__ == "__main__":
    main()

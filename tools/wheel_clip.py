"""Cut the clip of the wheel from the bundled clip: python tools/wheel_clip.py

The wheel has the first seconds of `examples/demo` (packets copied, not encoded again), so that it stays small. The whole
clip with its exact truth is in the repository and the source distribution.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import av

ROOT = Path(__file__).resolve().parents[1]
CLIP, CUT = ROOT / "examples" / "demo", ROOT / "examples" / "demo_wheel"
SECONDS = 6.0


def main() -> None:
    """Cut every video, and copy the rig."""
    (CUT / "videos").mkdir(parents=True, exist_ok=True)
    shutil.copyfile(CLIP / "rig.toml", CUT / "rig.toml")
    for video in sorted((CLIP / "videos").iterdir()):
        cut(video, CUT / "videos" / video.name)


def cut(video: Path, out: Path) -> None:
    """Copy the packets of the first seconds."""
    with av.open(str(video)) as source, av.open(str(out), "w") as target:
        stream = source.streams.video[0]
        copy = target.add_stream_from_template(stream)
        for packet in source.demux(stream):
            if packet.dts is None or packet.pts is None or float(packet.pts * packet.time_base) >= SECONDS:
                continue
            packet.stream = copy
            target.mux(packet)
    print(f"{out}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    main()

"""The packets of a video in another file."""

from pathlib import Path

import av


def remuxed(source: Path, target: Path, frames: int | None = None, stated: str = "", **how: object) -> Path:
    """`target` with the first `frames` packets of a video; `stated`: its creation time, `how`: as `av.open` takes it."""
    with av.open(str(source)) as whole, av.open(str(target), "w", **how) as copy:
        if stated:
            copy.metadata["creation_time"] = stated
        stream = copy.add_stream_from_template(whole.streams.video[0])
        for i, packet in enumerate(whole.demux(video=0)):
            if packet.dts is None or i == frames:
                break
            packet.stream = stream
            copy.mux(packet)
    return target

"""Videos by other encoders than ours, their packets in another file, and a source that plays a script."""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import built
import numpy as np

from posefuse.core import Frame, SourceError


def write_video(
    path: Path,
    images: Sequence[np.ndarray],
    codec: str = "libx264",
    base: Fraction = Fraction(1, 30),
    pts: Sequence[int] | None = None,
    *,
    pix_fmt: str = "yuv420p",
    stated: str = "",
    options: dict[str, str] | None = None,
    **how: str,
) -> Path:
    """(H, W, 3) uint8 RGB images, each at its number, or at `pts`, times `base` seconds; the rest as `remuxed`."""
    with av.open(str(path), "w", **how) as made:
        if stated:
            made.metadata["creation_time"] = stated
        stream = made.add_stream(codec, rate=30, options=options or {})
        stream.height, stream.width, stream.pix_fmt = *images[0].shape[:2], pix_fmt
        stream.time_base = stream.codec_context.time_base = base
        for number, image in zip(pts or range(len(images)), images, strict=True):
            frame = av.VideoFrame.from_ndarray(image)
            frame.pts, frame.time_base = number, base
            made.mux(stream.encode(frame))
        made.mux(stream.encode(None))
    return path


def remuxed(
    source: Path, target: Path, frames: int | None = None, stated: str = "", *, hidden_s: Fraction = Fraction(0), **how: object
) -> Path:
    """`target` with the first `frames` packets of a video; `stated`: its creation time, `how`: as `av.open` takes it.

    `hidden_s`: so much of its start is in the file and not shown, as after a cut without encoding again.
    """
    with av.open(str(source)) as whole, av.open(str(target), "w", **how) as copy:
        if stated:
            copy.metadata["creation_time"] = stated
        stream = copy.add_stream_from_template(whole.streams.video[0])
        for i, packet in enumerate(whole.demux(video=0)):
            if packet.dts is None or i == frames:
                break
            hidden = round(hidden_s / packet.time_base)
            packet.pts, packet.dts, packet.stream = packet.pts - hidden, packet.dts - hidden, stream
            copy.mux(packet)
    return target


class ScriptedSource:
    """Blank frames at these times, and an error after the last one if it `fails`.

    Args:
        of, shown_wh: camera and size of the frames, where they are others than stated.
    """

    def __init__(
        self,
        camera: str,
        times_ns: Sequence[int],
        size_wh: tuple[int, int] = (8, 6),
        fails: bool = False,
        *,
        of: str = "",
        shown_wh: tuple[int, int] | None = None,
    ) -> None:
        self.camera, self.size_wh, self.stated_frames, self.closed = camera, size_wh, len(times_ns), False
        self._times_ns, self._fails, self._of = times_ns, fails, of or camera
        self._image = np.zeros((*(shown_wh or size_wh)[::-1], 3), np.uint8)

    def times_ns(self) -> np.ndarray:
        return np.array(self._times_ns)

    def frames(self) -> Iterator[Frame]:
        for seq, t_ns in enumerate(self._times_ns):
            yield built.frame(self._of, t_ns, self._image, seq=seq)
        if self._fails:
            raise SourceError(f"camera {self.camera}: unplugged")

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        return (frame for frame in self.frames() if frame.t_ns >= begin_ns)

    def close(self) -> None:
        self.closed = True

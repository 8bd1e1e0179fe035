"""The images of cameras in Rerun while they are recorded."""

from __future__ import annotations

from collections.abc import Sequence

import cv2

from posefuse.outputs.rerun_scene import TIMELINE, camera_path, camera_views, opened_stream

from .camera_feed import FedFrame

_CAMERAS = "cameras"
_EVERY_NS, _SHOWN_PX, _QUALITY = 200_000_000, 640, 75


class RecordView:
    """Logs at a pace an eye can follow.

    Args:
        cameras: their names. place: ``spawn`` opens the viewer, anything else is the .rrd file to write.
    """

    def __init__(self, cameras: Sequence[str], place: str) -> None:
        import rerun.blueprint as rrb

        self._cameras = tuple(cameras)
        blueprint = rrb.Blueprint(camera_views(self._cameras, _CAMERAS), collapse_panels=True)
        self._stream = opened_stream("posefuse record", place, blueprint)
        self._shown_ns: dict[int, int] = {}

    def look(self, fed: FedFrame) -> None:
        """Show one frame, unless its camera was shown just now."""
        import rerun as rr

        if fed.t_ns - self._shown_ns.get(fed.camera, fed.t_ns - _EVERY_NS) < _EVERY_NS:
            return
        self._shown_ns[fed.camera] = fed.t_ns
        factor = min(1.0, _SHOWN_PX / max(fed.frame.size_wh))
        width, height = (round(side * factor) for side in fed.frame.size_wh)
        small = cv2.resize(fed.frame.image, (width, height), interpolation=cv2.INTER_AREA)
        self._stream.set_time(TIMELINE, duration=fed.t_ns / 1e9)
        self._stream.log(
            f"{camera_path(self._cameras[fed.camera], _CAMERAS)}/image", rr.Image(small).compress(jpeg_quality=_QUALITY)
        )

    def close(self) -> None:
        """Finish the stream."""
        self._stream.disconnect()

"""The images of cameras in Rerun while they are recorded."""

from __future__ import annotations

from collections.abc import Sequence

from posefuse.outputs.rerun_scene import TIMELINE, camera_path, camera_views, opened_stream

from .camera_feed import FedFrame
from .frame_view import DrawPace, small_image

_CAMERAS = "cameras"
_EVERY_NS, _QUALITY = 200_000_000, 75


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
        self._pace = DrawPace(_EVERY_NS)

    def look(self, fed: FedFrame) -> None:
        """Show one frame, unless its camera was shown just now."""
        import rerun as rr

        if not self._pace.due(fed.camera, fed.t_ns):
            return
        small, _ = small_image(fed.frame)
        self._stream.set_time(TIMELINE, duration=fed.t_ns / 1e9)
        self._stream.log(
            f"{camera_path(self._cameras[fed.camera], _CAMERAS)}/image", rr.Image(small).compress(jpeg_quality=_QUALITY)
        )

    def close(self) -> None:
        """Finish the stream."""
        self._stream.disconnect()

"""Guidance in Rerun: every camera's image, what was found and covered in it, which cameras are linked, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core.arrays import Array
from posefuse.outputs.rerun_scene import TIMELINE, camera_path, camera_views, opened_stream

from .frame_view import DrawPace, small_image

if TYPE_CHECKING:
    from posefuse.calibration.targets.guidance import Guidance

    from .guide_frame import GuideFrame

_CAMERAS = "cameras"
_EVERY_NS = 100_000_000
_FOUND_RGB, _CORNERS = (255, 220, 60), 4
_POOR_RGB, _RICH_RGB = np.array([235, 70, 60]), np.array([90, 200, 120])
_NODE, _THICKEST = 0.09, 0.03


class GuideView:
    """Logs at a pace an eye can follow.

    Args:
        cameras: their names. place: ``spawn`` opens the viewer, anything else is the .rrd file to write.
    """

    def __init__(self, cameras: Sequence[str], place: str) -> None:
        self._cameras = tuple(cameras)
        self._stream = opened_stream("posefuse calibrate guide", place, _blueprint(self._cameras))
        self._zero_ns: int | None = None
        self._pace = DrawPace(_EVERY_NS)

    def look(self, look: GuideFrame) -> None:
        """Show one frame and what it adds, unless its camera was shown just now."""
        if self._zero_ns is None:
            self._zero_ns = look.t_ns
        if not self._pace.due(look.camera, look.t_ns):
            return
        self._stream.set_time(TIMELINE, duration=(look.t_ns - self._zero_ns) / 1e9)
        self._image(look)
        self.state(look.state)

    def state(self, state: Guidance) -> None:
        """Show what is covered so far, and what to do next."""
        import rerun as rr

        self._stream.log("next", rr.TextDocument(next_page(state), media_type="text/markdown"))
        self._stream.log("together/links", _links(state))
        self._stream.log("together/cameras", _nodes(state))

    def close(self) -> None:
        """Finish the stream."""
        self._stream.disconnect()

    def _image(self, look: GuideFrame) -> None:
        import rerun as rr

        from posefuse.calibration.targets.coverage import coverage_picture

        path = camera_path(self._cameras[look.camera], _CAMERAS)
        small, factor = small_image(look.frame)
        size_wh = (small.shape[1], small.shape[0])
        picture = coverage_picture(look.state.coverage.cells[look.camera], size_wh, small)
        self._stream.log(f"{path}/image", rr.Image(picture).compress(jpeg_quality=75))
        # pixel centres are integers here and halves in Rerun
        xy = (look.corners.xy_img + 0.5) * factor
        self._stream.log(f"{path}/corners", rr.Points2D(xy, colors=_FOUND_RGB, radii=-2.0))
        self._stream.log(f"{path}/markers", rr.LineStrips2D(_quads(look.corners.patch, xy), colors=_FOUND_RGB, radii=-1.5))


def next_page(state: Guidance) -> str:
    """Markdown: what to do next, and how far every camera is."""
    covered = state.coverage
    rows = [
        f"| {name} | {share:.0%} | {seen} | {_partners(covered.cameras, together, i)} |"
        for i, (name, share, seen, together) in enumerate(
            zip(covered.cameras, covered.share, np.diag(covered.together), covered.together, strict=True)
        )
    ]
    head = ["| camera | image covered | moments seen | of these together with |", "|---|---|---|---|"]
    return "\n".join([f"# {state.words}", "", *head, *rows])


def _partners(names: Sequence[str], together: Array, own: int) -> str:
    counts = [(int(n), name) for i, (n, name) in enumerate(zip(together, names, strict=True)) if n and i != own]
    return ", ".join(f"{name} {n}" for n, name in sorted(counts, reverse=True)) or "**no camera**"


def _quads(patch: Array, xy: Array) -> list[Array]:
    """Closed outlines (5, 2) of the patches with four corners: markers, not boards."""
    ids, count = np.unique(patch, return_counts=True)
    return [xy[patch == i][[0, 1, 2, 3, 0]] for i in ids[count == _CORNERS]]


def _places(count: int) -> Array:
    """(count, 2) nodes on a circle, the first on top."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.sin(angle), -np.cos(angle)], axis=-1)


def _nodes(state: Guidance) -> Any:
    import rerun as rr

    names = [f"{name} {share:.0%}" for name, share in zip(state.coverage.cameras, state.coverage.share, strict=True)]
    return rr.Points2D(_places(len(names)), colors=_colours(state.covered), radii=_NODE, labels=names, show_labels=True)


def _links(state: Guidance) -> Any:
    import rerun as rr

    place, share = _places(len(state.coverage.cameras)), state.linked
    pairs = [(i, j) for i in range(len(share)) for j in range(i) if share[i, j] > 0]
    strips = [place[[i, j]] for i, j in pairs]
    level = np.array([share[i, j] for i, j in pairs])
    names = [str(int(state.coverage.together[i, j])) for i, j in pairs]
    return rr.LineStrips2D(strips, colors=_colours(level), radii=_THICKEST * level, labels=names, show_labels=True)


def _colours(level: Array) -> Array:
    """RGB (n, 3) from red to green for levels (n,) from 0 to 1."""
    return np.asarray(_POOR_RGB + level.reshape(-1, 1) * (_RICH_RGB - _POOR_RGB), np.uint8)


def _blueprint(cameras: Sequence[str]) -> Any:
    import rerun.blueprint as rrb

    right = rrb.Vertical(
        rrb.TextDocumentView(origin="next", name="what to do next"),
        rrb.Spatial2DView(origin="together", contents=["$origin/**"], name="moments two cameras saw it together"),
        row_shares=[1, 1],
    )
    return rrb.Blueprint(rrb.Horizontal(camera_views(cameras, _CAMERAS), right, column_shares=[3, 2]), collapse_panels=True)

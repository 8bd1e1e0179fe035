"""The newest transforms of ``/tf`` and ``/tf_static``, and how one frame lies in another."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import SE3

_LONGEST = 100


class TfTree:
    """Newest transform of each frame to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, SE3]] = {}

    def take(self, msg: Any) -> None:
        """Take a `tf2_msgs/TFMessage` in; transforms that are not finite are left out."""
        for one in msg.transforms:
            t, q = one.transform.translation, one.transform.rotation
            numbers = np.array([q.w, q.x, q.y, q.z, t.x, t.y, t.z])
            if np.isfinite(numbers).all() and np.linalg.norm(numbers[:4]) > 0.5:
                place = SE3(numbers[:4], numbers[4:])
                self._parents[one.child_frame_id.lstrip("/")] = (one.header.frame_id.lstrip("/"), place)

    def lookup(self, target: str, source: str) -> SE3 | None:
        """target_from_source; None where the tree does not connect them."""
        up_target, up_source = self._to_root(target), self._to_root(source)
        if up_target[0] != up_source[0]:
            return None
        return up_target[1].inverse() @ up_source[1]

    def _to_root(self, frame: str) -> tuple[str, SE3]:
        """Root of the tree that a frame is in, and root_from_frame."""
        place = SE3.identity()
        for _ in range(_LONGEST):
            if frame not in self._parents:
                break
            frame, parent_from_frame = self._parents[frame]
            place = parent_from_frame @ place
        return frame, place

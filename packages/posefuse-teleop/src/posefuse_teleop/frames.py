"""Frames of other nodes: where one tf frame is in another, by the newest transforms of `/tf` and `/tf_static`."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from posefuse.core import SE3, MessageError

_MOST_FRAMES = 2000
# a quaternion shorter than this is a field that was left out, not a rotation
_LEAST_NORM = 0.5


class Frames:
    """The tree of frames received so far; a frame has one parent, the newest. Names count without a leading slash."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, SE3]] = {}

    def take(self, tf: Any) -> None:
        """One `geometry_msgs/TransformStamped`; raises MessageError for one that is not finite or has no rotation."""
        q, p = tf.transform.rotation, tf.transform.translation
        numbers = np.array([q.w, q.x, q.y, q.z, p.x, p.y, p.z])
        if not (np.isfinite(numbers).all() and np.linalg.norm(numbers[:4]) > _LEAST_NORM):
            raise MessageError(f"tf of {tf.child_frame_id}: expected finite numbers and a unit quaternion")
        self.add(tf.header.frame_id, tf.child_frame_id, SE3(numbers[:4], numbers[4:]))

    def add(self, parent: str, child: str, parent_from_child: SE3) -> None:
        """One transform."""
        child = child.lstrip("/")
        if child in self._parents or len(self._parents) < _MOST_FRAMES:
            self._parents[child] = parent.lstrip("/"), parent_from_child

    def find(self, target: str, source: str) -> SE3 | None:
        """target_from_source, or None where no chain of transforms joins them."""
        up, down = self._to_root(source.lstrip("/")), self._to_root(target.lstrip("/"))
        for frame, root_from_source in up.items():
            if frame in down:
                return down[frame].inverse() @ root_from_source
        return None

    def path(self, target: str, source: str) -> frozenset[str]:
        """The child frames of the transforms that join two frames."""
        return frozenset(self._upwards(source.lstrip("/"))) ^ frozenset(self._upwards(target.lstrip("/")))

    def _to_root(self, frame: str) -> dict[str, SE3]:
        """From a frame up: every frame on the path, and where the first one is in it."""
        found = {frame: SE3.identity()}
        for child, parent in pairwise(self._upwards(frame)):
            found[parent] = self._parents[child][1] @ found[child]
        return found

    def _upwards(self, frame: str) -> list[str]:
        """A frame, its parent and so on; a circle ends before it closes."""
        found = [frame]
        while frame in self._parents and (frame := self._parents[frame][0]) not in found:
            found.append(frame)
        return found

"""What the views of a finished recording saw, brought to the joint centres its 3D lies at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import JointCentres, PoseSequence, Rig, ViewSequence
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import PartsOfViews

from .joint_centres import LandmarksInParts
from .sides import parts_of_steps, sides_that_differ, with_sides_exchanged


class ViewsAtJointCentres:
    """A recording's views as if its detector marked joint centres, which is where its 3D is: rays then lead there.

    Each view's keypoints move by what lies between landmark and joint centre in that image, at every time step by the
    offsets in the body's own directions; where the 3D is missing, by as much as before and after. Left and right are named
    as in 3D. Without a table keypoints stay where they are. Views are made for a part of the time steps when it is asked for.
    """

    def __init__(self, poses: PoseSequence, rig: Rig, views: PartsOfViews, table: JointCentres | None) -> None:
        """`poses`: the 3D, at joint centres. `rig`, `views`: of the same people, cameras and times. `table`: of their offsets."""
        self._rig, self._views = rig, views
        self._landmarks = LandmarksInParts(poses.xyz_world, poses.skeleton, table) if table else None
        self._points = poses.xyz_world
        shape = poses.xyz_world.shape
        moves = np.empty((*shape[:2], len(rig), shape[2], 2))
        for part in parts_of_steps(len(poses)):
            moves[part] = self._moves(part, self._marked(part))
        missing = ~np.isfinite(moves)
        _bridge(moves)
        # only those: of an hour, all of them take much memory, and the others are soon made again
        self._missing, self._bridged = np.flatnonzero(missing), moves[missing]

    def part(self, steps: slice) -> ViewSequence:
        """The views of these time steps."""
        seen, landmarks = self._views.part(steps), self._marked(steps)
        named = with_sides_exchanged(seen, sides_that_differ(landmarks, self._rig, seen))
        moves = self._moves(steps, landmarks)
        begin = steps.indices(len(self._points))[0] * moves[:1].size
        here = slice(*np.searchsorted(self._missing, [begin, begin + moves.size]))
        moves.reshape(-1)[self._missing[here] - begin] = self._bridged[here]
        return replace(named, xy_img=named.xy_img + moves)

    def _marked(self, steps: slice) -> Array:
        return self._landmarks.part(steps) if self._landmarks else self._points[steps]

    def _moves(self, steps: slice, landmarks: Array) -> Array:
        """(T, N, C, K, 2) pixels from landmark to joint centre; NaN where either is missing."""
        ends = self._points[steps], landmarks
        return np.stack([np.subtract(*map(camera.project, ends)) for camera in self._rig], axis=2)


def _bridge(moves: Array) -> None:
    """Interpolate what is missing of (T, ...) over time, in place; 0 where nothing is known."""
    columns = moves.reshape(len(moves), -1)
    for column in columns.T:
        known = np.isfinite(column)
        column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known]) if known.any() else 0.0

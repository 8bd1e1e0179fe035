"""Second pass: all views brought to common instants, fused anew, gaps and noise treated over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import InputError, Pose3D, PoseSequence, Recording, Rig, Skeleton, Views
from posefuse.core.arrays import Array
from posefuse.fusion import FuseSettings, fuse
from posefuse.tracking import JointCentres, SmoothSettings, sides_like, smooth, steady_sides, to_joint_centres

from .following import Seen

# a frame this close to its instant counts as taken at it
_SAME_INSTANT_NS = 200_000
# two frames further apart than this many periods are not interpolated between
_REACH_PERIODS = 1.6
# rounds of naming sides; a second one mends what the first one's reference still had wrong
_NAMING_ROUNDS = 2
# a person followed in fewer instants than this is not one
_LEAST_INSTANTS = 5


@dataclass(frozen=True, eq=False)
class ViewSequence:
    """The same people in every camera, over time: `Views` with an axis T in front, person_id excepted.

    Attributes:
        t_ns: (T,). person_id: (N,). xy_img: (T, N, C, K, 2). score, sigma_px: (T, N, C, K).
    """

    t_ns: Array
    skeleton: Skeleton
    camera_names: tuple[str, ...]
    person_id: Array
    xy_img: Array
    score: Array
    sigma_px: Array

    def at(self, i: int) -> Views:
        """The instant at place i of axis T."""
        return Views(
            int(self.t_ns[i]), self.skeleton, self.camera_names, self.person_id, self.xy_img[i], self.score[i], self.sigma_px[i]
        )


def views_over_time(seen: Sequence[Seen]) -> ViewSequence:
    """Collect the people followed long enough and bring every camera to the common instants.

    A camera whose frames lie between the instants gets keypoints interpolated linearly between its two frames around
    each instant, so that cameras without hardware synchronisation agree on moving people.

    Raises:
        InputError: nobody was followed in at least a few instants.
    """
    first = seen[0].views
    ids, counts = np.unique(np.concatenate([s.views.person_id for s in seen]), return_counts=True)
    ids = ids[counts >= min(_LEAST_INSTANTS, len(seen))]
    if len(ids) == 0:
        raise InputError("no person could be followed in at least two cameras at once")
    t_ns = np.array([s.views.t_ns for s in seen])
    shape = (len(seen), len(ids), len(first.camera_names), len(first.skeleton))
    xy, score, sigma = np.full((*shape, 2), np.nan), np.zeros(shape), np.full(shape, np.nan)
    for i, s in enumerate(seen):
        for n, person in enumerate(s.views.person_id):
            place = np.flatnonzero(ids == person)
            if len(place):
                xy[i, place[0]], score[i, place[0]], sigma[i, place[0]] = s.views.xy_img[n], s.views.score[n], s.views.sigma_px[n]
    frame_t_ns = np.array([s.frame_t_ns for s in seen])
    for c in range(shape[2]):
        _to_instants(t_ns, frame_t_ns[:, c], xy[:, :, c], score[:, :, c], sigma[:, :, c])
    return ViewSequence(t_ns, first.skeleton, first.camera_names, ids, xy, score, sigma)


def views_of(recording: Recording) -> ViewSequence:
    """The views a recording was made from, to be fused again in another way."""
    poses = recording.poses
    return ViewSequence(
        poses.t_ns, poses.skeleton, recording.rig.names, poses.person_id, recording.xy_img, recording.score, recording.sigma_px
    )


def _to_instants(t_ns: Array, frame_t_ns: Array, xy: Array, score: Array, sigma: Array) -> None:
    """Move one camera's (T, N, K) keypoints from its frames' times to the instants, in place."""
    late_ns = frame_t_ns - t_ns
    if (np.abs(late_ns) <= _SAME_INSTANT_NS).all() or len(t_ns) < 2:
        return
    xy_then, score_then, sigma_then = xy.copy(), score.copy(), sigma.copy()
    reach_ns = _REACH_PERIODS * np.median(np.diff(t_ns))
    for i in range(len(t_ns)):
        if abs(late_ns[i]) <= _SAME_INSTANT_NS:
            continue
        j = i - 1 if late_ns[i] > 0 else i + 1  # the frame on the other side of the instant
        if not 0 <= j < len(t_ns):
            continue
        span_ns = frame_t_ns[j] - frame_t_ns[i]
        if span_ns == 0 or abs(span_ns) > reach_ns:
            continue
        share = float(np.clip(-late_ns[i] / span_ns, 0, 1))
        both = (score_then[i] > 0) & (score_then[j] > 0)
        xy[i][both] = (xy_then[i] * (1 - share) + xy_then[j] * share)[both]
        score[i][both] = np.minimum(score_then[i], score_then[j])[both]
        # a network errs alike in neighbouring frames, so blending two does not make it surer
        sigma[i][both] = (sigma_then[i] * (1 - share) + sigma_then[j] * share)[both]


def poses_over_time(
    views: ViewSequence,
    rig: Rig,
    fusing: FuseSettings,
    smoothing: SmoothSettings | None,
    centres: JointCentres | None = None,
) -> PoseSequence:
    """Fuse every instant, move keypoints to joint centres (with `centres`), then (with `smoothing`) treat gaps and noise over
    the whole recording.

    Where sides may be untangled, the recording is first steadied over time and then every view's limbs are named left and
    right as the steadied recording has them: when legs pass each other, several views confuse them at once and no single
    instant can tell.
    """
    fused = _fused(views, rig, fusing)
    if fusing.weights == "robust" and fusing.untangle_sides:
        named = replace(fusing, untangle_sides=False)
        for _ in range(_NAMING_ROUNDS):
            reference = smooth(steady_sides(fused), smoothing or SmoothSettings())
            xy, score, sigma = sides_like(reference, rig, views.xy_img, views.score, views.sigma_px)
            fused = _fused(replace(views, xy_img=xy, score=score, sigma_px=sigma), rig, named)
    fused = to_joint_centres(fused, centres) if centres else fused
    return smooth(fused, smoothing) if smoothing else fused


def _fused(views: ViewSequence, rig: Rig, fusing: FuseSettings) -> PoseSequence:
    poses: list[Pose3D] = []
    for i in range(len(views.t_ns)):
        poses.append(fuse(views.at(i), rig, fusing, poses[-1] if poses else None))
    return PoseSequence.from_poses(poses)

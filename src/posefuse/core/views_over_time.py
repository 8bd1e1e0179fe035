"""The people of a recording in every camera at the common time steps: what fusion and pictures work on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .arrays import Array, check_fields, freeze_fields
from .errors import ShapeError
from .observations import LIVE_STEP, NOT_KEPT, DetectionBatch, LookKind, Observations
from .skeleton import Skeleton
from .values import Detections2D, Views

# a frame this close to its time step counts as taken at it
_SAME_TIME_NS = 200_000
# two frames further apart than this many periods are not interpolated between
_REACH_PERIODS = 1.6
_PLANES = ("xy_img", "score", "sigma_px")


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewSequence:
    """The same people in every camera, over time: `Views` with an axis T in front, person_id excepted.

    Attributes:
        t_ns: (T,). camera_names: axis C. person_id: (N,).
        xy_img: (T, N, C, K, 2) raw distorted px; NaN where unseen. score, sigma_px: (T, N, C, K); 0 and NaN where unseen.
    """

    t_ns: Array
    skeleton: Skeleton
    camera_names: tuple[str, ...]
    person_id: Array
    xy_img: Array
    score: Array
    sigma_px: Array

    def __post_init__(self) -> None:
        freeze_fields(self, {"t_ns": np.int64, "person_id": np.int64} | dict.fromkeys(_PLANES, np.float64))
        axes = {"t_ns": "T", "person_id": "N", "xy_img": "T N C K 2", "score": "T N C K", "sigma_px": "T N C K"}
        sizes = check_fields(self, axes)
        if (sizes["C"], sizes["K"]) != (len(self.camera_names), len(self.skeleton)):
            raise ShapeError(
                f"ViewSequence: {len(self.camera_names)} camera names and {len(self.skeleton)} keypoints, arrays have {sizes}"
            )

    def at(self, i: int) -> Views:
        """The time step at place i of axis T."""
        return Views(
            t_ns=int(self.t_ns[i]),
            skeleton=self.skeleton,
            camera_names=self.camera_names,
            person_id=self.person_id,
            xy_img=self.xy_img[i],
            score=self.score[i],
            sigma_px=self.sigma_px[i],
        )


def views_over_time(observations: Observations, person_id: Iterable[int]) -> ViewSequence:
    """Every camera's keypoints of these people, brought to the common time steps.

    A camera whose frames lie between the time steps gets keypoints interpolated linearly between its two frames around
    each, so that cameras without hardware synchronisation agree on moving people.
    """
    ids = np.array(list(person_id), np.int64)
    by_id = np.argsort(ids)
    t_ns, names = observations.step_t_ns, observations.camera_names
    shape = (len(t_ns), len(ids), len(names), len(observations.skeleton))
    xy, score, sigma = np.full((*shape, 2), np.nan), np.zeros(shape), np.full(shape, np.nan)
    frame = observations.detection_frame
    rows = np.flatnonzero(np.isin(observations.person_id, ids) & (observations.frame_step[frame] != LIVE_STEP))
    step, camera = observations.frame_step[frame[rows]], observations.frame_camera[frame[rows]]
    at = (step, by_id[np.searchsorted(ids[by_id], observations.person_id[rows])], camera)
    xy[at], score[at], sigma[at] = observations.xy_img[rows], observations.score[rows], observations.sigma_px[rows]
    frame_t_ns = _frame_times(observations)
    for c in range(len(names)):
        _to_time_steps(t_ns, frame_t_ns[:, c], xy[:, :, c], score[:, :, c], sigma[:, :, c])
    return ViewSequence(
        t_ns=t_ns, skeleton=observations.skeleton, camera_names=names, person_id=ids, xy_img=xy, score=score, sigma_px=sigma
    )


def observations_from_views(views: ViewSequence) -> Observations:
    """Observations of cameras that were exposed exactly at the time steps: made-up recordings, data of other tools.

    The box is that of the keypoints.
    """
    batches, person_ids = [], []
    for i, t_ns in enumerate(views.t_ns.tolist()):
        detections, ids = [], []
        for c, camera in enumerate(views.camera_names):
            here = (views.score[i, :, c] > 0).any(axis=-1)
            xy, score, sigma = views.xy_img[i, here, c], views.score[i, here, c], views.sigma_px[i, here, c]
            detections.append(
                Detections2D(
                    camera=camera,
                    t_ns=t_ns,
                    skeleton=views.skeleton,
                    xy_img=xy,
                    score=score,
                    sigma_px=sigma,
                    box_img=keypoint_boxes(xy, score),
                )
            )
            ids.append(views.person_id[here])
        batches.append(DetectionBatch(step=i, t_ns=t_ns, kind=LookKind.EXPECTED, detections=tuple(detections)))
        person_ids.append(ids)
    return Observations.from_batches(views.skeleton, views.camera_names, batches, person_ids)


def keypoint_boxes(xy_img: Array, score: Array) -> Array:
    """(P, 4) left, top, right, bottom of the keypoints (P, K, 2) that were seen; NaN where none was."""
    seen = ((score > 0) & np.isfinite(xy_img).all(axis=-1))[..., None]
    low, high = np.where(seen, xy_img, np.inf).min(axis=1), np.where(seen, xy_img, -np.inf).max(axis=1)
    box = np.concatenate([low, high], axis=-1)
    return np.where(np.isfinite(box), box, np.nan)


def people_in(observations: Observations) -> tuple[Array, Array]:
    """(N,) ids of all people in the observations, and (N,) in how many time steps each was seen by any camera."""
    kept = observations.person_id != NOT_KEPT
    frame = observations.detection_frame[kept]
    seen = np.unique(np.stack([observations.person_id[kept], observations.frame_step[frame]]), axis=1)
    ids, counts = np.unique(seen[0], return_counts=True)
    return ids, counts


def _frame_times(observations: Observations) -> Array:
    """(T, C) exposure time of each camera's frame; the time step itself where it has none."""
    times = np.repeat(observations.step_t_ns[:, None], len(observations.camera_names), axis=1)
    recorded = observations.frame_step != LIVE_STEP
    times[observations.frame_step[recorded], observations.frame_camera[recorded]] = observations.frame_t_ns[recorded]
    return times


def _to_time_steps(t_ns: Array, frame_t_ns: Array, xy: Array, score: Array, sigma: Array) -> None:
    """Move one camera's (T, N, K) keypoints from its frames' times to the time steps, in place."""
    late_ns = frame_t_ns - t_ns
    if (np.abs(late_ns) <= _SAME_TIME_NS).all() or len(t_ns) < 2:
        return
    xy_then, score_then, sigma_then = xy.copy(), score.copy(), sigma.copy()
    reach_ns = _REACH_PERIODS * np.median(np.diff(t_ns))
    for i in range(len(t_ns)):
        if abs(late_ns[i]) <= _SAME_TIME_NS:
            continue
        j = i - 1 if late_ns[i] > 0 else i + 1  # the frame on the other side of the time step
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

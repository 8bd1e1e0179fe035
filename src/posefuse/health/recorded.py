"""How well each camera of a recording fits the others, and which ones were moved, swapped or are unsynchronised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.core import Observations, PoseSequence, Recording, Rig, ViewSequence, views_over_time
from posefuse.core.arrays import Array, known_median
from posefuse.core.observations import NOT_KEPT
from posefuse.tracking.sides import sides_like

from .rig_monitor import RigFinding, new_monitor_state, observe

# more views add nothing: a network's errors are correlated for longer than this
_EVERY_S = 0.1
# limb keypoints by which a detection is compared with the person
_LEAST_KEYPOINTS = 4
UNFIT = "unfit"
# a camera does not fit when a larger share of its views is left out, so many standard deviations off in the median; good sessions
# of real footage reach 0.34 at 1.5 (`bench/rig_monitor.py --track`)
_LEFT_OUT, _SIGMAS = 0.4, 3.0


@dataclass(frozen=True, kw_only=True)
class CameraFit:
    """How well one camera fits the person that all cameras saw.

    Attributes:
        seen: share of its images that have the person. left_out: share of these that the result does not use,
            because the detection is not where the other cameras see the person.
        reproj_px: median distance of all its detections of the person, those left out too, from the reprojected result; NaN where
            there is none. sigmas: the same in units of the stated standard deviation of a coordinate.
    """

    seen: float
    left_out: float
    reproj_px: float
    sigmas: float


def checked_rig(recording: Recording, rig: Rig) -> tuple[dict[str, CameraFit], list[RigFinding]]:
    """Each camera's fit, by name, and cameras that were moved, swapped or unsynchronised (needs three cameras).

    Where nothing of that is certain, but cameras fit too badly to be used, these are found (`UNFIT`). The person who is seen
    most is looked at.
    """
    seen = np.isfinite(recording.poses.xyz_world[..., 0]).sum(axis=(0, 2))
    person, poses, log = np.arange(len(seen)) == seen.argmax(), recording.poses, recording.observations
    period_s = float(np.median(np.diff(poses.t_ns))) / 1e9 if len(poses) > 1 else _EVERY_S
    step = max(1, round(_EVERY_S / period_s))
    poses, log = poses.part(slice(None, None, step)).people(person), log.part(slice(None, None, step))
    views = _views_of_person(log, poses, recording.rig)
    fits = _fits(log, poses, recording.rig, views)
    return fits, _findings(views, rig, fits)


def _findings(views: ViewSequence, rig: Rig, fits: Mapping[str, CameraFit]) -> list[RigFinding]:
    limbs = limb_keypoints(views.skeleton.keypoints)
    xy = np.where((views.score[:, 0] >= MIN_SCORE)[..., None], views.xy_img[:, 0], np.nan)[:, :, limbs]
    state, found = new_monitor_state(rig), []
    for t_ns, seen in zip(views.t_ns.tolist(), xy, strict=True):
        state, new = observe(state, rig, t_ns, seen)
        found += new
    bad = {name: one for name, one in fits.items() if one.left_out > _LEFT_OUT and one.sigmas > _SIGMAS}
    return found if found or not bad else [_unfit(bad, int(views.t_ns[0]))]


def _unfit(bad: Mapping[str, CameraFit], t_ns: int) -> RigFinding:
    each = ", ".join(f"{name} {one.left_out:.0%} ({one.reproj_px:.0f} px off)" for name, one in bad.items())
    words = (
        f"views are left out, because the other cameras see the person elsewhere: {each}; is the calibration the one of these"
        " cameras, and of where they are now?"
    )
    return RigFinding(kind=UNFIT, cameras=tuple(bad), t_ns=t_ns, detail=words, displaced_m=np.nan)


def _fits(log: Observations, poses: PoseSequence, rig: Rig, views: ViewSequence) -> dict[str, CameraFit]:
    images, kept = np.zeros((2, len(rig), len(poses)), bool)
    images[log.frame_camera, log.frame_step] = True
    frame = log.detection_frame[log.person_id == poses.person_id[0]]
    kept[log.frame_camera[frame], log.frame_step[frame]] = True
    seen, limbs = np.asarray((views.score[:, 0] > 0).any(axis=2).T), limb_keypoints(views.skeleton.keypoints)
    fits = {}
    for c, camera in enumerate(rig):
        off_px = np.linalg.norm(camera.project(poses.xyz_world[:, 0]) - views.xy_img[:, 0, c], axis=-1)[:, limbs]
        fits[camera.name] = CameraFit(
            seen=float(seen[c].sum() / max(images[c].sum(), 1)),
            left_out=float((seen & ~kept)[c].sum() / max(seen[c].sum(), 1)),
            reproj_px=known_median(off_px),
            sigmas=known_median(off_px / views.sigma_px[:, 0, c][:, limbs]),
        )
    return fits


def _views_of_person(log: Observations, poses: PoseSequence, rig: Rig) -> ViewSequence:
    """The person in each camera, wherever it is: in every image the detection most like the person in shape.

    A camera that is not where the rig has it shows people where the others see none. Such detections belong to no person of the
    result, but how a body is posed in an image hardly depends on the direction of the camera.
    """
    [person] = poses.person_id.tolist()
    unlike_px = np.where(np.isin(log.person_id, (person, NOT_KEPT)), _unlike_px(log, poses, rig), np.inf)
    frame = log.detection_frame
    order = np.lexsort((unlike_px, log.frame_camera[frame], log.frame_step[frame]))
    place = np.stack([log.frame_camera[frame], log.frame_step[frame]])[:, order]
    best = order[np.diff(place, axis=1, prepend=-2).any(axis=0)]
    ids = np.full(len(log), NOT_KEPT)
    ids[best[np.isfinite(unlike_px[best])]] = person
    return sides_like(poses, rig, views_over_time(log.with_person_ids(ids), [person]))


def _unlike_px(log: Observations, poses: PoseSequence, rig: Rig) -> Array:
    """(R,) how far the limbs of each detection are from the person's when the middles lie on each other; inf where unknown."""
    frame, limbs = log.detection_frame, limb_keypoints(log.skeleton.keypoints)
    expected = rig.project(poses.xyz_world[:, 0, limbs])
    off = log.xy_img[:, limbs] - expected[log.frame_camera[frame], log.frame_step[frame]]
    off[log.score[:, limbs] < MIN_SCORE] = np.nan
    known = np.isfinite(off[..., 0]).sum(axis=1) >= _LEAST_KEYPOINTS
    unlike_px = np.full(len(log), np.inf)
    off = off[known] - np.nanmedian(off[known], axis=1, keepdims=True)
    unlike_px[known] = np.nanmedian(np.linalg.norm(off, axis=-1), axis=1)
    return unlike_px

"""How far joint angles are from a reference, joint by joint and axis by axis; a gait laboratory's own, out of its C3D file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import SE3, SKELETONS, InputError, JointAngles, PoseSequence
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.view_sequences import nearest_frames
from posefuse.formats.c3d import C3dData, read_c3d

_NEAREST_NS = 2_000_000
_SKELETON = SKELETONS["anatomical23"]
# Vicon's virtual points: ends of femur, tibia; markers of heel and toe
_POINTS = {"hip": "FEP", "knee": "FEO", "ankle": "TIO", "heel": "HEE", "big_toe": "TOE", "small_toe": "TOE"}
_ANGLES = {
    "hip": ("HipAngles", ("flexion", "adduction", "internal_rotation")),
    "knee": ("KneeAngles", ("flexion", "adduction", "internal_rotation")),
    "ankle": ("AnkleAngles", ("dorsiflexion", "inversion", "internal_rotation")),
}
_LETTER = {"left": "L", "right": "R"}
_SIGMA_M = 0.001
# so far above the hips the surrogate of the trunk is put, along the laboratory's own pelvis axis
_TRUNK_M = 0.5


@dataclass(frozen=True, kw_only=True)
class AngleError:
    """One angle of one joint over a recording, all people together, degrees.

    Attributes:
        joint, angle: names.
        bias_deg: mean error; a constant offset between two definitions of a segment shows here.
        sd_deg: standard deviation of the error about its mean. rmse_deg: root mean square of the error.
        stated_deg: median of the standard deviation the estimate itself states.
        defined: share of time steps with an estimate.
    """

    joint: str
    angle: str
    bias_deg: float
    sd_deg: float
    rmse_deg: float
    stated_deg: float
    defined: float


def angle_errors(estimate: JointAngles, reference: JointAngles) -> list[AngleError]:
    """Errors of every angle both know by name, at the time steps of the estimate nearest to those of the reference.

    Raises:
        InputError: other people, no time step within 2 ms of one of the reference, or no angle in common.
    """
    if len(estimate.person_id) != len(reference.person_id):
        raise InputError(f"angles: expected {len(reference.person_id)} people as in the reference, got {len(estimate.person_id)}")
    at, back = _matched(estimate.t_ns, reference.t_ns)
    errors = []
    for q, joint in enumerate(estimate.joints):
        if joint not in reference.joints:
            continue
        r = reference.joints.index(joint)
        for a, angle in enumerate(estimate.angle_names[q]):
            if angle not in reference.angle_names[r]:
                continue
            b = reference.angle_names[r].index(angle)
            got, wanted = estimate.angle_rad[at, :, q, a], reference.angle_rad[back, :, r, b]
            errors.append(_error(joint, angle, got, wanted, estimate.sigma_rad[at, :, q, a]))
    if not errors:
        raise InputError(f"angles: no angle in common; the reference has {', '.join(reference.joints)}")
    return errors


def _matched(t_ns: Array, reference_ns: Array) -> tuple[Array, Array]:
    """Places in both of time steps that are the same."""
    place = nearest_frames(reference_ns, t_ns)
    same = np.flatnonzero(np.abs(reference_ns[place] - t_ns) <= _NEAREST_NS)
    if not len(same):
        raise InputError("angles: estimate and reference have no time step in common (within 2 ms)")
    return same, place[same]


def _error(joint: str, angle: str, got: Array, wanted: Array, sigma: Array) -> AngleError:
    error = np.degrees(np.angle(np.exp(1j * (got - wanted))))
    known = np.isfinite(error)
    error, stated = error[known], np.degrees(sigma[known])
    found = (error.mean(), error.std(), np.sqrt((error**2).mean()), np.median(stated)) if known.any() else (np.nan,) * 4
    figures = dict(zip(("bias_deg", "sd_deg", "rmse_deg", "stated_deg"), map(float, found), strict=True))
    return AngleError(joint=joint, angle=angle, defined=float(known.mean()), **figures)


def poses_from_lab(path: Path) -> PoseSequence:
    """Joint centres (hip, knee, ankle) and foot markers of a Plug-in-Gait C3D as an ``anatomical23`` recording.

    The laboratory's pelvis axis (PELO to PELP) replaces the trunk, because the file may lack the shoulders: so the hip angles
    share the laboratory's pelvis, and only those of knee and ankle are wholly ours.

    Raises:
        InputError: it cannot be read or lacks a point; names it and lists what there is.
    """
    data = read_c3d(path)
    xyz = np.full((len(data.xyz_world), 1, len(_SKELETON), 3), np.nan)
    pelvis = _point(path, data, "PELP") - _point(path, data, "PELO")
    up = pelvis / np.linalg.norm(pelvis, axis=-1, keepdims=True)
    middle = (_point(path, data, "LFEP") + _point(path, data, "RFEP")) / 2
    for side, letter in _LETTER.items():
        for name, label in _POINTS.items():
            xyz[:, 0, _SKELETON.index(f"{side}_{name}")] = _point(path, data, letter + label)
        xyz[:, 0, _SKELETON.index(f"{side}_shoulder")] = middle + _TRUNK_M * up
    seen = np.isfinite(xyz[..., 0])
    cov = np.where(seen[..., None, None], np.eye(3) * _SIGMA_M**2, np.nan)
    none = np.zeros(seen.shape)
    return PoseSequence(
        t_ns=_times(data),
        skeleton=_SKELETON,
        person_id=np.zeros(1),
        xyz_world=xyz,
        cov_world=cov,
        reproj_px=none,
        n_views=none,
        kind=seen,
    )


def joints_from_lab(path: Path) -> JointAngles:
    """The laboratory's own hip, knee and ankle angles; frames are unknown (NaN). Raises InputError as `poses_from_lab`."""
    data = read_c3d(path)
    names, angles = [], []
    for side, letter in _LETTER.items():
        for joint, (label, _) in _ANGLES.items():
            if letter + label not in data.angle_names:
                raise InputError(f"{path}: no angles {letter + label}; there are: {choices(data.angle_names)}")
            names.append(f"{side}_{joint}")
            angles.append(data.angle_rad[:, data.angle_names.index(letter + label)])
    angle = np.stack(angles, axis=1)[:, None]
    frames = SE3(np.full((len(angle), 1, 0, 4), np.nan), np.full((len(angle), 1, 0, 3), np.nan))
    kinds = tuple(kind for _ in _LETTER for _, kind in _ANGLES.values())
    return JointAngles(
        t_ns=_times(data),
        person_id=np.zeros(1),
        segments=(),
        world_from_segment=frames,
        joints=tuple(names),
        angle_names=kinds,
        angle_rad=angle,
        sigma_rad=np.full(angle.shape, np.nan),
    )


def _times(data: C3dData) -> np.ndarray:
    return np.round(np.arange(len(data.xyz_world)) * 1e9 / data.rate_hz).astype(np.int64)


def _point(path: Path, data: C3dData, name: str) -> np.ndarray:
    if name not in data.names:
        raise InputError(f"{path}: no point {name}; there are: {choices(data.names)}")
    return np.asarray(data.xyz_world[:, data.names.index(name)])

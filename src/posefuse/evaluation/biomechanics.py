"""Everything a biomechanist wants of a recording: angles, files their tools open, a page to look at."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from posefuse.core import InputError, JointAngles, PoseSequence, Progress, Recording, Skeleton, silent
from posefuse.core.arrays import Array
from posefuse.core.poses import evenly_spaced, point_sigma_m
from posefuse.core.skeleton import SIDES
from posefuse.formats.bvh import write_bvh
from posefuse.formats.c3d import C3dData, C3dEvent, write_c3d
from posefuse.formats.gltf import write_gltf
from posefuse.formats.mot import motion_from_joints, write_mot
from posefuse.foundation.settings import settings
from posefuse.kinematics import joints_from_poses, undefined_segments
from posefuse.kinematics.animation import animation_from_joints
from posefuse.kinematics.body import bodies_from_poses, fit_poses
from posefuse.kinematics.definitions import joints_without_points
from posefuse.kinematics.gait import Gait, gait_from_poses
from posefuse.kinematics.opensim_scale import opensim_library, scaled_motion
from posefuse.kinematics.skin import skin_of
from posefuse.outputs.data_files import write_angles
from posefuse.outputs.provenance import duration_s, person_suffix

from .gait_cycles import gait_cycles, write_gait_cycles
from .report import TITLE, write_report

_CENTIMETRES = 0.01
_STAGES = 3


@settings
class BiomechanicsSettings:
    """What is made of a recording.

    Attributes:
        fit: ``points`` fits one skeleton per person to the 3D points; ``none`` takes the angles straight from the points, as
            both do where the skeleton has no hips or no shoulders.
        opensim_model: an .osim of the user's own to scale to each person and to run inverse kinematics on; needs the extra
            ``biomech``.
    """

    fit: Literal["none", "points"] = "points"
    opensim_model: Path | None = None


def joints_of(recording: Recording, chosen: BiomechanicsSettings) -> tuple[PoseSequence, JointAngles]:
    """Keypoints and joints of a recording, by the chosen fit.

    Raises:
        InputError: left and right are swapped, or no person was seen well enough to have a skeleton.
    """
    if not _is_fitted(recording.poses.skeleton, chosen):
        return recording.poses, joints_from_poses(recording.poses)
    fit = fit_poses(recording.poses)
    return fit.poses, fit.joints


def how_angles_are_made(skeleton: Skeleton, chosen: BiomechanicsSettings) -> str:
    """From what the angles and the files for other programs come."""
    if not _is_fitted(skeleton, chosen):
        return "straight from the 3D points of the result"
    return (
        "of one skeleton of constant segment lengths per person, fitted to the points of the result, which smooths them; "
        "`posefuse report --fit none` takes them straight from the 3D points"
    )


def _is_fitted(skeleton: Skeleton, chosen: BiomechanicsSettings) -> bool:
    return chosen.fit != "none" and "pelvis" not in undefined_segments(skeleton)


def write_biomechanics(
    recording: Recording,
    folder: Path,
    chosen: BiomechanicsSettings | None = None,
    *,
    title: str = TITLE,
    progress: Progress = silent,
) -> list[Path]:
    """Write into an existing folder; returns the files made.

    ``angles.csv``, ``report.html``, and ``gait_cycles.csv`` if a person walks. Per person ``angles.mot``
    (OpenSim), ``points_angles.c3d``, ``skeleton.bvh`` (centimetres, Y up), ``skeleton.glb``, and with `opensim_model` a folder
    ``opensim``. With several people these names end in ``_ID``. People who cannot be animated (`animation_from_joints`
    gives the reason) have no skeleton files.

    Args:
        recording: the result. folder: where to write. chosen: what is made of it. title: of the page.
        progress: called as each of three stages begins, with a message that names it, and at the end.

    Raises:
        InputError: see `joints_of`; a place that cannot be written to. DependencyError: OpenSim is missing.
    """
    chosen = chosen or BiomechanicsSettings()
    if chosen.opensim_model:
        opensim_library()
    how = how_angles_are_made(recording.poses.skeleton, chosen)
    progress("report", 0, _STAGES, f"joint angles of {len(recording.poses)} time steps, {how}")
    uneven = ""
    try:
        even = evenly_spaced(recording.poses)
        recording = recording if even is recording.poses else replace(recording, poses=even)
    except InputError as error:
        uneven = str(error)
    poses, joints = joints_of(recording, chosen)
    # of the recording's own points, as on the page, so that all files have the same events
    gaits = [gait_from_poses(recording.poses, n) for n in range(len(poses.person_id))]
    if lacking := joints_without_points(poses.skeleton):
        progress("report", 1, _STAGES, lacking)
    progress("report", 1, _STAGES, "tables and files for other programs")
    made = [folder / "angles.csv"]
    write_angles(made[0], joints)
    for n in range(len(poses.person_id)):
        ending = person_suffix(recording, n)
        if np.isfinite(joints.angle_rad[:, n]).any():
            notes, files = _person_files(
                poses, joints, n, folder, ending, name=recording.person_names[n], gait=gaits[n], uneven=uneven
            )
            for note in notes:
                progress("report", 1, _STAGES, note)
            made += files
            if chosen.opensim_model:
                made += _opensim_files(poses, n, folder / f"opensim{ending}", chosen.opensim_model)
    progress("report", 2, _STAGES, "gait cycles and the page")
    walking = zip(poses.person_id.tolist(), gaits, strict=True)
    if cycles := {person: gait_cycles(joints, n, gait) for n, (person, gait) in enumerate(walking) if gait is not None}:
        made.append(write_gait_cycles(folder / "gait_cycles.csv", cycles))
    del poses, cycles  # the page is of the recording's own points
    made.append(write_report(recording, joints, folder / "report.html", title=title, angles=how))
    progress("report", _STAGES, _STAGES)
    return made


def _person_files(
    poses: PoseSequence,
    joints: JointAngles,
    n: int,
    folder: Path,
    ending: str,
    *,
    name: str,
    gait: Gait | None,
    uneven: str,
) -> tuple[list[str], list[Path]]:
    """What to say about the files of angles and of the moving skeleton, and these files; `uneven`: why some cannot be."""
    made = [folder / f"angles{ending}.mot"]
    motion, note = motion_from_joints(joints, n)
    write_mot(made[0], motion)
    notes = [f"angles{ending}.mot: {note}"] if note else []
    del motion
    if uneven:
        return [*notes, f"no points_angles{ending}.c3d, skeleton{ending}.bvh and .glb: {uneven}"], made
    made.append(folder / f"points_angles{ending}.c3d")
    write_c3d(made[-1], _c3d_data(poses, joints, n, name, gait))
    try:
        animation = animation_from_joints(poses, joints, n)
    except InputError as error:
        return [*notes, f"no skeleton{ending}.bvh and .glb: {error}"], made
    made += [folder / f"skeleton{ending}.bvh", folder / f"skeleton{ending}.glb"]
    write_bvh(made[-2], animation, _CENTIMETRES)
    write_gltf(made[-1], animation, skin=skin_of(animation))
    return notes, made


def _c3d_data(poses: PoseSequence, joints: JointAngles, n: int, name: str, gait: Gait | None) -> C3dData:
    span_s = duration_s(poses)
    labels, angles = _c3d_angles(joints, n)
    return C3dData(
        names=poses.skeleton.keypoints,
        xyz_world=poses.xyz_world[:, n],
        sigma_m=point_sigma_m(poses.cov_world[:, n]),
        rate_hz=(len(poses) - 1) / span_s if span_s > 0 else 1.0,
        angle_names=labels,
        angle_rad=angles,
        begin_s=poses.t_ns[0] * 1e-9,
        subject=name,
        events=_events(gait, float(poses.t_ns[0]) * 1e-9),
    )


def _events(gait: Gait | None, begin_s: float) -> tuple[C3dEvent, ...]:
    if gait is None:
        return ()
    kinds = {"strike": gait.strike_s, "off": gait.off_s}
    return tuple(
        sorted(C3dEvent(float(t_s) - begin_s, side, kind) for kind, at in kinds.items() for side in SIDES for t_s in at[side])
    )


def _c3d_angles(joints: JointAngles, n: int) -> tuple[tuple[str, ...], Array]:
    """Labels and angles (T, A, 3) as C3D wants them: three at a time, all there or all missing.

    An angle that joint centres never determine is zero by construction (`Joint.determined`) and written so.
    """
    angle = joints.angle_rad[:, n]
    ever = np.asarray(np.isfinite(angle).any(axis=0))
    kept = np.asarray(np.flatnonzero(ever.any(axis=1)))
    return tuple(f"{joints.joints[q]}_angles" for q in kept), np.where(ever, angle, 0.0)[:, kept]


def _opensim_files(poses: PoseSequence, n: int, folder: Path, model: Path) -> list[Path]:
    folder.mkdir(exist_ok=True)
    scaled_motion(model, poses, folder, n, bodies_from_poses(poses)[int(poses.person_id[n])])
    return sorted(folder.iterdir())

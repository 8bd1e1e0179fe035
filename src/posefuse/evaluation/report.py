"""The report about a recording, one page for people who are not engineers: origin, movement, and how far to trust each figure."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posefuse import __version__
from posefuse.core import InputError, JointAngles, Kind, Recording
from posefuse.core.arrays import Array, known_median
from posefuse.core.palette import LEGEND
from posefuse.core.skeleton import SIDES
from posefuse.formats.page import (
    MISSING,
    Band,
    Block,
    Cards,
    Cell,
    Details,
    Facts,
    Heading,
    Line,
    Note,
    Page,
    Player,
    Plot,
    Plots,
    Series,
    Side,
    Table,
    Ticks,
    write_page,
)
from posefuse.formats.rig import refusal_note
from posefuse.foundation.summary import number_text
from posefuse.kinematics.gait import Gait, Spread, gait_from_poses
from posefuse.outputs.provenance import duration_s, recorded_utc

from .gait_cycles import HEADING, PERCENT, CycleAngles, gait_cycles, side_of

QUALITY_COLUMNS = ("keypoint", "measured", "filled", "cameras", "reprojection px", "standard deviation mm", "longest gap s")

CAMERA_COLUMNS = ("camera", "person seen", "of it left out", "reprojection px", "in standard deviations")


def quality_rows(recording: Recording, person: int) -> list[list[Any]]:
    """Rows under `QUALITY_COLUMNS` of the person at this place of axis N.

    Share of time steps with a measured 3D point, and of those filled from neighbours; medians of the cameras used, of the
    reprojection error and of the standard deviation (root of the mean variance of the axes); longest time without a measured
    point. A keypoint that is measured in less than half of the time stands out.
    """
    poses = recording.poses
    t_s = poses.t_ns * 1e-9
    rows = []
    for k, name in enumerate(poses.skeleton.keypoints):
        kind, views = poses.kind[:, person, k], poses.n_views[:, person, k]
        known = np.isfinite(poses.xyz_world[:, person, k, 0])
        measured = known & np.isin(kind, (Kind.FUSED, Kind.SMOOTHED))
        variance = np.trace(poses.cov_world[:, person, k], axis1=-2, axis2=-1) / 3
        found, filled = _share(measured), _share(known & ~measured)
        row = [
            Cell(name.replace("_", " "), "" if found > 0.5 else "bad"), f"{100 * found:.0f} %", f"{100 * filled:.0f} %",
            number_text(known_median(views[measured].astype(float)), 0),
            number_text(known_median(poses.reproj_px[:, person, k][measured]), 1),
            number_text(1e3 * float(np.sqrt(known_median(variance[known]))), 1), number_text(longest_gap(t_s, measured), 2),
        ]  # fmt: skip
        rows.append(row)
    return rows


def camera_rows(fits: Mapping[str, Mapping[str, float]]) -> list[list[Any]]:
    """Rows under `CAMERA_COLUMNS` of the fields of `health.recorded.CameraFit`, by camera."""
    return [[name, f"{one['seen']:.0%}", f"{one['left_out']:.0%}", one["reproj_px"], one["sigmas"]] for name, one in fits.items()]


def _share(mask: Array) -> float:
    return float(mask.mean()) if len(mask) else float("nan")


def longest_gap(t_s: Array, measured: Array) -> float:
    """Longest time without a measured point (T,); 0 where none is missing."""
    if not len(t_s):
        return float("nan")
    at = t_s[measured]
    edges = np.concatenate([[t_s[0]], at, [t_s[-1]]])
    longest = float(np.diff(edges).max())
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    return longest if longest > 1.5 * usual else 0.0


TITLE = "Motion report"
BAND_SIGMAS = 2.0
_SHORT_ID = 12
_PAIRS = ("hip", "shoulder")


def write_report(
    recording: Recording,
    joints: JointAngles,
    out: Path,
    title: str = TITLE,
    angles: str = "",
) -> Path:
    """Write one HTML page that needs no other file and no network.

    Args:
        recording: the result to report on.
        joints: its angles, over the same time steps and people.
        out: the file to write, e.g. ``report.html``.
        title: on top of the page. angles: how they were made, in words.

    Raises:
        InputError: joints of other time steps or people, or a place that cannot be written to.
    """
    poses = recording.poses
    if not (np.array_equal(joints.t_ns, poses.t_ns) and np.array_equal(joints.person_id, poses.person_id)):
        raise InputError(
            f"report: expected joints of the {len(poses)} time steps and {len(poses.person_id)} people of the recording, "
            f"got {len(joints.t_ns)} time steps and {len(joints.person_id)} people"
        )
    made = {"joint angles": angles} if angles else {}
    blocks: list[Block] = [Facts(_origin(recording) | made), _cards(recording)]
    if refusal := refusal_note("rig", recording.rig):
        blocks.append(Note(refusal, warning=True))
    for name in ("incomplete_cameras", "rig_warnings"):
        blocks += [Note(str(line), warning=True) for line in recording.provenance.get(name) or ()]
    if len(poses) and np.isfinite(poses.xyz_world).any():
        blocks += [Heading("The recording in 3D"), _player(recording)]
    for n in range(len(poses.person_id)):
        blocks += _person(recording, joints, n)
    if fits := recording.provenance.get("camera_fits"):
        blocks += [Heading("Cameras"), Table(CAMERA_COLUMNS, camera_rows(fits))]
    if recording.provenance:
        settings = {key: _text(value) for key, value in recording.provenance.items()}
        blocks += [Heading("How it was made"), Details("Settings and versions", [Facts(settings)])]
    return write_page(out, Page(title, blocks))


def _origin(recording: Recording) -> dict[str, str]:
    rig = recording.rig
    recorded = recorded_utc(recording.provenance).replace("T", " ").replace("Z", " UTC")
    return {
        "session": str(recording.provenance.get("session", "unnamed")),
        "people": ", ".join(recording.person_names),
        "date of the recording": recorded or "not stated by the files",
        "date of this report": date.today().isoformat(),
        "rig": f"{len(rig)} cameras ({', '.join(rig.names)}), id {rig.id[:_SHORT_ID]}, world frame: {rig.world_set_by}",
        "version": f"posefuse {__version__}",
    }


def _cards(recording: Recording) -> Cards:
    poses = recording.poses
    lasts_s = duration_s(poses)
    values = {
        "duration": f"{lasts_s:.2f} s",
        "time steps": str(len(poses)),
        "cameras": str(len(recording.rig)),
        "person" if len(poses.person_id) == 1 else "people": str(len(poses.person_id)),
        f"keypoints, {poses.skeleton.name}": str(len(poses.skeleton)),
    }
    if lasts_s > 0:
        values["time steps per second"] = f"{(len(poses) - 1) / lasts_s:.1f}"
    if recording.rig.residual_px > 0:  # unknown is NaN, and simulated cameras have none
        values["calibration residual"] = f"{recording.rig.residual_px:.2f} px"
    return Cards(values)


def _player(recording: Recording) -> Player:
    poses = recording.poses
    names = poses.skeleton.keypoints
    pairs = [(f"right_{part}", f"left_{part}") for part in _PAIRS]
    sides: list[Side] = [
        side_of(names[a]) if side_of(names[a]) == side_of(names[b]) else "mid" for a, b in poses.skeleton.bone_indices
    ]
    return Player(
        poses.t_ns * 1e-9,
        poses.xyz_world,
        bones=poses.skeleton.bone_indices,
        sides=sides,
        people=list(recording.person_names),
        right_left=[(names.index(a), names.index(b)) for a, b in pairs if a in names and b in names],
    )


def _person(recording: Recording, joints: JointAngles, n: int) -> list[Block]:
    poses = recording.poses
    name = recording.person_names[n]
    name = name[:1].upper() + name[1:]
    if not np.isfinite(poses.xyz_world[:, n]).any():
        return [Heading(name), Note("Not seen in any time step.")]
    gait = gait_from_poses(poses, n)
    cycles = gait_cycles(joints, n, gait) if gait is not None else []
    blocks: list[Block] = [Heading(f"{name}: walking"), *parameter_blocks(gait, cycles)]
    if gait is not None and cycles:
        blocks += [
            Heading(
                f"{name}: joint angles over the gait cycle",
                "From one foot strike (0 %) to the next strike of the same foot (100 %). Thick lines: mean; bands: "
                "± 1 standard deviation; thin lines: the first strides; ticks on the axis: foot off. "
                f"{LEGEND} The pelvis rotates relative to the walking direction.",
            ),
            Plots(cycle_plots(cycles, gait), small=True),
        ]
    events = " Ticks on the axis: foot strikes." if gait is not None else ""
    return [
        *blocks,
        Heading(
            f"{name}: joint angles over time",
            f"Bands: ± {BAND_SIGMAS:g} standard deviations of the measurement.{events} {LEGEND}",
        ),
        Plots(time_plots(joints, n, gait, BAND_SIGMAS), small=True),
        Heading("Range of motion over the whole recording", level=3),
        range_table(joints, n),
        Heading(f"{name}: quality of the data", "How often each keypoint was measured, by how many cameras, and how precisely."),
        Table(QUALITY_COLUMNS, quality_rows(recording, n)),
    ]


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)


_SHARE_DRAWN = 0.02
# single strides drawn per side; all of them are in gait_cycles.csv
_MOST_CYCLES = 10
_FIRST = ("pelvis", "hip", "knee", "ankle")


def title_of(joint: str, angle: str) -> str:
    """The same for left and right: ``Knee flexion``."""
    part = joint.removeprefix("left_").removeprefix("right_")
    return f"{part} {angle}".replace("_", " ").capitalize()


def rank_of(joint: str) -> int:
    """The place of a joint in the report: pelvis and legs come first."""
    part = joint.removeprefix("left_").removeprefix("right_")
    return _FIRST.index(part) if part in _FIRST else len(_FIRST)


def time_plots(joints: JointAngles, person: int, gait: Gait | None, band_sigmas: float) -> list[Plot]:
    """One plot per angle, left and right together, with bands of the stated uncertainty."""
    t_s = joints.t_ns * 1e-9
    strikes = [Ticks(f"{side} foot strike", times, colour=side) for side, times in (gait.strike_s if gait else {}).items()]
    plots = []
    for title, members in _grouped(joints).items():
        series: list[Series] = []
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, person, q, a])
            if np.isfinite(values).mean() > _SHARE_DRAWN:
                side, band = side_of(joints.joints[q]), band_sigmas * np.degrees(joints.sigma_rad[:, person, q, a])
                series.append(Band(f"{side} ± {band_sigmas:g} sd", t_s, values - band, values + band, colour=side))
                series.append(Line(side if side in SIDES else "trunk", t_s, values, colour=side))
        if series:
            plots.append(Plot(title, [*series, *strikes], x_label="s", y_label="degrees", legend=False))
    return plots


def cycle_plots(cycles: list[CycleAngles], gait: Gait) -> list[Plot]:
    """One plot per angle over 0 to 100 % of the gait cycle: mean, standard deviation and single strides, left and right."""
    groups: dict[str, list[CycleAngles]] = {}
    for one in sorted(cycles, key=lambda one: rank_of(one.joint)):
        groups.setdefault(title_of(one.joint, one.angle), []).append(one)
    return [
        Plot(title, [*_foot_off(gait), *(part for one in members for part in _cycle_series(one))], x_label="% of the gait cycle",
             y_label="degrees", window=_window(members), legend=False)
        for title, members in groups.items()
    ]  # fmt: skip


def range_table(joints: JointAngles, person: int) -> Table:
    """Least, most, range and mean of every angle over the whole recording, and the median of its stated uncertainty."""
    rows = []
    for title, members in _grouped(joints).items():
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, person, q, a])
            known = values[np.isfinite(values)]
            if len(known) <= _SHARE_DRAWN * len(values):
                continue
            sigma = float(np.degrees(np.nanmedian(joints.sigma_rad[:, person, q, a])))
            side = side_of(joints.joints[q])
            figures = [f"{figure:.1f}" for figure in (known.min(), known.max(), np.ptp(known), known.mean(), sigma)]
            shown = "" if side == "mid" else Cell(side, side)
            rows.append([title, shown, *figures, f"{100 * len(known) / len(values):.0f} %"])
    spread = "standard deviation of the measurement"
    return Table(["angle, degrees", "side", "least", "greatest", "range", "mean", spread, "known in"], rows)


def _cycle_series(one: CycleAngles) -> list[Series]:
    """Every stride, thin; and their mean with a band of one standard deviation."""
    side, mean, sd = side_of(one.joint), np.degrees(one.mean_rad), np.degrees(one.sd_rad)
    name = f"{side if side in SIDES else 'trunk'}, mean of {len(one.angle_rad)}"
    strides = [
        Line(f"{side} stride {i}", PERCENT, np.degrees(values), colour=side, faint=True)
        for i, values in enumerate(one.angle_rad[:_MOST_CYCLES], start=1)
    ]
    return [*strides, Band(f"{side} ± sd", PERCENT, mean - sd, mean + sd, colour=side), Line(name, PERCENT, mean, colour=side)]


def _foot_off(gait: Gait) -> list[Series]:
    shares = {side: gait.stance_share[side].mean for side in SIDES}
    return [
        Ticks(f"{side} foot off", np.array([100 * share]), colour=side) for side, share in shares.items() if np.isfinite(share)
    ]


def _window(members: list[CycleAngles]) -> tuple[float, float, float, float]:
    """All of the means and bands, with room."""
    low = min(float(np.degrees(one.mean_rad - one.sd_rad).min()) for one in members)
    high = max(float(np.degrees(one.mean_rad + one.sd_rad).max()) for one in members)
    room = 0.15 * (high - low) + 1.0
    return 0.0, 100.0, low - room, high + room


def _grouped(joints: JointAngles) -> dict[str, list[tuple[int, int]]]:
    """Places (joint, angle) by title, left and right of one angle together, legs first.

    The heading of the pelvis is left out: it counts the person's turns in the room, and is no angle of a joint.
    """
    groups: dict[str, list[tuple[int, int]]] = {}
    for q, joint in sorted(enumerate(joints.joints), key=lambda one: rank_of(one[1])):
        for a, angle in enumerate(joints.angle_names[q]):
            if (joint, angle) == HEADING:
                continue
            groups.setdefault(title_of(joint, angle), []).append((q, a))
    return groups


# a space at which a line does not break
_KEPT = "\N{NO-BREAK SPACE}"
# angles whose range over the gait cycle is in the table
RANGES = (("hip", "flexion"), ("knee", "flexion"), ("ankle", "dorsiflexion"))
_ASYMMETRY = "Asymmetry of the {}"
_COLUMNS = ("parameter", "side", "value")


def parameter_blocks(gait: Gait | None, cycles: list[CycleAngles]) -> list[Block]:
    """The table with its notes; a note only where the person does not walk."""
    if gait is None:
        return [Note("No walking found: gait parameters need two foot strikes of each foot.")]
    rows = [
        _row("Walking speed", f"{gait.speed_m_s:.2f}{_KEPT}m/s"),
        _row("Cadence", f"{gait.cadence_per_min:.0f}{_KEPT}steps/min"),
        _row("Stride length", spread_text(gait.stride_length_m, "m")),
        _row("Stride time", spread_text(gait.stride_time_s, "s")),
        *(_row("Step length", spread_text(gait.step_length_m[side], "m"), side) for side in SIDES),
        _row("Step width", spread_text(gait.step_width_m, "m")),
        _row(_ASYMMETRY.format("step length"), _asymmetry(gait.step_length_m)),
        *(_row("Stance phase", spread_text(gait.stance_share[side], "%", 100.0, 0), side) for side in SIDES),
        _row(_ASYMMETRY.format("stance phase"), _asymmetry(gait.stance_share)),
        _row("Double support", spread_text(gait.double_support_share, "%", 100.0, 0)),
        *_ranges(cycles),
    ]
    return [
        Table(_COLUMNS, rows, text=True),
        Note("Mean ± standard deviation (number of steps or strides). Asymmetry: left minus right, as a share of their mean."),
    ]


def spread_text(spread: Spread, unit: str, scale: float = 1.0, digits: int = 2) -> str:
    """``0.71 ± 0.02 m (12)``, broken before the count alone; one value has no deviation; a dash for none."""
    if not spread.count:
        return MISSING
    unit = unit if unit == "°" else f"{_KEPT}{unit}"
    sd = f"{_KEPT}±{_KEPT}{scale * spread.sd:.{digits}f}" if spread.count > 1 else ""
    return f"{scale * spread.mean:.{digits}f}{sd}{unit} ({spread.count})"


def _asymmetry(sides: Mapping[str, Spread]) -> str:
    """Left minus right, in per cent of their mean; a dash where one is not known."""
    left, right = (sides[side].mean for side in SIDES)
    share = 100 * (left - right) / ((left + right) / 2)
    return f"{share:+z.0f}{_KEPT}%" if np.isfinite(share) else MISSING


def _ranges(cycles: list[CycleAngles]) -> list[list[Any]]:
    """Range over the gait cycle of `RANGES`."""
    return [
        _row(
            f"{title_of(part, angle)}, range over the gait cycle",
            spread_text(Spread.of(np.degrees(one.ranges_rad)), "°", digits=0),
            one.side,
        )
        for part, angle in RANGES
        for one in cycles
        if (one.joint, one.angle) == (f"{one.side}_{part}", angle)
    ]


def _row(name: str, value: str, side: Literal["", "left", "right"] = "") -> list[Any]:
    return [name, Cell(side, side), value]

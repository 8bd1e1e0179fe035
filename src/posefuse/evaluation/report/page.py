"""The page: what was recorded, how the person moved, how far each figure can be trusted."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from posefuse.core import InputError, JointAngles, Recording
from posefuse.core.arrays import Array
from posefuse.foundation.atomic import atomic_file
from posefuse.kinematics.gait import Gait, Spread, gait_from_poses

from .quality import keypoint_quality, views_picture
from .style import STYLE
from .svg import Curve, chart, stick_figures

_BAND_SIGMAS = 2.0
_FIGURES = 9
_SHARE_DRAWN = 0.02


def write_report(recording: Recording, joints: JointAngles, out: Path, pictures: Mapping[str, bytes] | None = None) -> Path:
    """Write one HTML page that needs no other file and no network.

    Args:
        recording: the result to report on.
        joints: its angles, over the same instants and people.
        out: the file to write, e.g. ``report.html``.
        pictures: captions to JPEG images shown at the top, e.g. overlays.

    Raises:
        InputError: joints of other instants or people, or a place that cannot be written to.
    """
    poses = recording.poses
    if not (np.array_equal(joints.t_ns, poses.t_ns) and np.array_equal(joints.person_id, poses.person_id)):
        raise InputError(
            f"report: expected joints of the {len(poses)} instants and {len(poses.person_id)} people of the recording, "
            f"got {len(joints.t_ns)} instants and {len(joints.person_id)} people"
        )
    sections = [_head(recording), _pictures(pictures or {})]
    sections += [_person(recording, joints, n) for n in range(len(poses.person_id))]
    sections.append(_origin(recording))
    html = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">'
        f"<title>posefuse report</title><style>{STYLE}</style></head><body><main>{''.join(sections)}</main></body></html>\n"
    )
    with atomic_file(out) as beside:
        beside.write_text(html, encoding="utf-8")
    return out


def _head(recording: Recording) -> str:
    poses = recording.poses
    duration_s = float(poses.t_ns[-1] - poses.t_ns[0]) * 1e-9 if len(poses) else 0.0
    rate_hz = (len(poses) - 1) / duration_s if duration_s > 0 else float("nan")
    facts = {
        "duration": f"{duration_s:.2f} s",
        "instants": str(len(poses)),
        "rate": _number(rate_hz, "Hz"),
        "cameras": str(len(recording.rig)),
        "people": str(len(poses.person_id)),
        "keypoints": f"{len(poses.skeleton)} ({poses.skeleton.name})",
        "calibration": _number(recording.rig.residual_px, "px", 2),
    }
    cards = "".join(f"<div><b>{escape(value)}</b><span>{escape(name)}</span></div>" for name, value in facts.items())
    incomplete = recording.provenance.get("incomplete_cameras") or []
    lines = "".join(f'<p class="warning">{escape(str(line))}</p>' for line in incomplete)
    return f'<header><h1>Recording</h1><div class="cards">{cards}</div>{lines}</header>'


def _pictures(pictures: Mapping[str, bytes]) -> str:
    figures = [
        f'<figure><img alt="{escape(caption)}" src="data:image/jpeg;base64,{base64.b64encode(data).decode()}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for caption, data in pictures.items()
    ]
    return f'<div class="pictures">{"".join(figures)}</div>' if figures else ""


def _person(recording: Recording, joints: JointAngles, n: int) -> str:
    poses = recording.poses
    name = f"Person {poses.person_id[n]}"
    if not np.isfinite(poses.xyz_world[:, n]).any():
        return f"<section><h2>{name}</h2><p>Not seen in any instant.</p></section>"
    gait = gait_from_poses(poses, n)
    return (
        f"<section><h2>{name}</h2>{_strip(recording, n)}"
        f"{_walk(gait)}"
        f"<h3>Joint angles</h3>{_legend(gait)}<div class='charts'>{''.join(_charts(joints, n, gait))}</div>"
        f"<h3>Range of motion</h3>{_ranges(joints, n)}"
        f"<h3>Quality of the data</h3>{_quality(recording, n)}</section>"
    )


def _strip(recording: Recording, n: int) -> str:
    """The person from their left side, at equal times."""
    poses = recording.poses
    seen = np.flatnonzero(np.isfinite(poses.xyz_world[:, n, :, 0]).mean(axis=-1) > 0.5)
    if not len(seen):
        return ""
    at = seen[np.linspace(0, len(seen) - 1, min(_FIGURES, len(seen))).round().astype(int)]
    xyz = poses.xyz_world[at, n]
    across = _across(recording, n, at)
    flat = np.stack([(xyz * across[:, None]).sum(-1), xyz[..., 2]], axis=-1)
    names = poses.skeleton.keypoints
    sides = [_side(names[a]) if _side(names[a]) == _side(names[b]) else "mid" for a, b in poses.skeleton.bone_indices]
    labels = [f"{float(poses.t_ns[i] - poses.t_ns[0]) * 1e-9:.2f} s" for i in at]
    return stick_figures(flat, poses.skeleton.bone_indices, sides, labels)


def _across(recording: Recording, n: int, at: Array) -> Array:
    """(F, 3) horizontal unit direction the person faces at each instant: the drawing's right."""
    poses = recording.poses
    hips = [
        poses.skeleton.keypoints.index(f"{side}_hip") if f"{side}_hip" in poses.skeleton.keypoints else 0
        for side in ("left", "right")
    ]
    line = poses.xyz_world[at, n, hips[1]] - poses.xyz_world[at, n, hips[0]]
    facing = np.stack([-line[:, 1], line[:, 0], np.zeros(len(at))], axis=-1)
    norm = np.linalg.norm(facing, axis=-1, keepdims=True)
    return np.where(norm > 1e-6, facing / np.maximum(norm, 1e-6), [1.0, 0.0, 0.0])


def _side(name: str) -> str:
    return name.split("_")[0] if name.startswith(("left_", "right_")) else "mid"


def _walk(gait: Gait | None) -> str:
    if gait is None:
        return "<p class='note'>No walking found: gait measures need two foot strikes of each foot.</p>"
    rows = [
        ("Speed", f"{gait.speed_m_s:.2f} m/s"),
        ("Cadence", f"{gait.cadence_per_min:.0f} steps/min"),
        ("Stride length", _spread(gait.stride_length_m, "m")),
        ("Stride time", _spread(gait.stride_time_s, "s")),
        ("Step length, left", _spread(gait.step_length_m["left"], "m")),
        ("Step length, right", _spread(gait.step_length_m["right"], "m")),
        ("Step width", _spread(gait.step_width_m, "m")),
        ("Stance, left", _spread(gait.stance_share["left"], "%", 100.0, 0)),
        ("Stance, right", _spread(gait.stance_share["right"], "%", 100.0, 0)),
    ]
    cells = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in rows)
    return f"<h3>Walking</h3><table class='narrow'>{cells}</table><p class='note'>Mean ± standard deviation (count).</p>"


def _legend(gait: Gait | None) -> str:
    events = " Ticks on the time axis: foot strikes." if gait else ""
    return (
        '<p class="legend"><span class="key left"></span> left <span class="key right"></span> right '
        f'<span class="key mid"></span> trunk, pelvis, neck. Bands: ± {_BAND_SIGMAS:g} standard deviations.{events}</p>'
    )


def _charts(joints: JointAngles, n: int, gait: Gait | None) -> list[str]:
    t_s = (joints.t_ns - joints.t_ns[:1]) * 1e-9
    marks = [(float(t), side) for side, times in (gait.strike_s if gait else {}).items() for t in times]
    charts = []
    for title, members in _grouped(joints).items():
        curves = []
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, n, q, a])
            if np.isfinite(values).mean() > _SHARE_DRAWN:
                band = _BAND_SIGMAS * np.degrees(joints.sigma_rad[:, n, q, a])
                curves.append(Curve(values, band, _side(joints.joints[q]), joints.joints[q].replace("_", " ")))
        if curves:
            charts.append(chart(title, "°", t_s, curves, marks))
    return charts


def _grouped(joints: JointAngles) -> dict[str, list[tuple[int, int]]]:
    """Charts by title, left and right of one angle together."""
    groups: dict[str, list[tuple[int, int]]] = {}
    for q, joint in enumerate(joints.joints):
        part = joint.removeprefix("left_").removeprefix("right_")
        for a, angle in enumerate(joints.angle_names[q]):
            groups.setdefault(f"{part} {angle}".replace("_", " ").capitalize(), []).append((q, a))
    return groups


def _ranges(joints: JointAngles, n: int) -> str:
    rows = []
    for title, members in _grouped(joints).items():
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, n, q, a])
            known = values[np.isfinite(values)]
            if len(known) <= _SHARE_DRAWN * len(values):
                continue
            sigma = float(np.degrees(np.nanmedian(joints.sigma_rad[:, n, q, a])))
            cells = (known.min(), known.max(), np.ptp(known), known.mean(), sigma, 100 * len(known) / len(values))
            numbers = "".join(f"<td>{cell:.1f}</td>" for cell in cells[:5]) + f"<td>{cells[5]:.0f} %</td>"
            side = _side(joints.joints[q])
            rows.append(f"<tr><th>{escape(title)}</th><td class='{side}'>{side if side != 'mid' else ''}</td>{numbers}</tr>")
    head = _row("angle (degrees)", "side", "least", "most", "range", "mean", "sigma", "defined")
    return f"<table>{head}{''.join(rows)}</table>"


def _quality(recording: Recording, n: int) -> str:
    rows = []
    for k in keypoint_quality(recording, n):
        numbers = (
            f"{100 * k.found:.0f} %", f"{100 * k.filled:.0f} %", _number(k.views, "", 0), _number(k.reproj_px, "", 1),
            _number(k.sigma_mm, "", 1), _number(k.longest_gap_s, "", 2),
        )  # fmt: skip
        worst = " class='bad'" if not k.found > 0.5 else ""
        rows.append(
            f"<tr{worst}><th>{escape(k.keypoint.replace('_', ' '))}</th>{''.join(f'<td>{text}</td>' for text in numbers)}</tr>"
        )
    head = _row("keypoint", "measured", "filled", "views", "reprojection px", "sigma mm", "longest gap s")
    picture = views_picture(recording, n)
    image = f'<img class="raster" alt="views over time" src="data:image/png;base64,{_png(picture)}">' if picture.size else ""
    note = "<p class='note'>Cameras used per keypoint (rows, in the order of the table) over time: red none, blue all.</p>"
    return f"{image}{note}<table>{head}{''.join(rows)}</table>"


def _origin(recording: Recording) -> str:
    items = "".join(
        f"<tr><th>{escape(str(key))}</th><td>{escape(str(value))}</td></tr>" for key, value in recording.provenance.items()
    )
    return f"<section><h2>How it was made</h2><table class='narrow'>{items}</table></section>" if items else ""


def _row(*names: str) -> str:
    return "<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"


def _number(value: float, unit: str, digits: int = 1) -> str:
    return f"{value:.{digits}f} {unit}".strip() if np.isfinite(value) else "–"


def _spread(spread: Spread, unit: str, scale: float = 1.0, digits: int = 2) -> str:
    if not spread.count:
        return "–"
    return f"{scale * spread.mean:.{digits}f} ± {scale * spread.sd:.{digits}f} {unit} ({spread.count})"


def _png(picture: Array) -> str:
    import cv2

    done, data = cv2.imencode(".png", picture[..., ::-1])
    if not done:
        raise InputError(f"report: a picture of shape {picture.shape} could not be encoded as PNG")
    return base64.b64encode(data.tobytes()).decode()

"""C3D: points over time as biomechanics tools read them (Mokka, Visual3D, Vicon, OpenSim); written by ezc3d.

Converted on reading and writing: millimetres and degrees. Axes stay ours: Z is up, which ``POINT:Y_SCREEN = +Z`` states; a file
that states ``+Y`` is turned as TRC is. A missing
point has the residual -1. The residual of a point is its standard deviation in millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from posefuse import __version__
from posefuse.core import DiskFullError, InputError, ShapeError
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.errors import choices
from posefuse.foundation.output_file import atomic_file

from .c3d_blocks import BLOCK_BYTES, LAST_IN_HEADER, POINT_BYTES, Group, completed_head, data_start, read_blocks

_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
# residuals are stored as so many steps of this size; a file with larger ones gets a coarser step
_FINEST_RESIDUAL_MM = 0.1
# of the byte's 255: some readers take it as signed
_MOST_STEPS = 127
# a string of a C3D parameter is at most 127 bytes in every reader
_TEXT_BYTES = 127
_NAMES_PER_PARAMETER = 255
# frames that are written together
_PART_FRAMES = 1000
_EVENT_LABELS = {"strike": "Foot Strike", "off": "Foot Off"}


class C3dEvent(NamedTuple):
    """`strike` or `off` of the `left` or `right` foot, in seconds from the first frame."""

    t_s: float
    side: str
    kind: str


@dataclass(frozen=True, eq=False, kw_only=True)
class C3dData:
    """Named points, and angles stored as such, over time.

    Attributes:
        names: K points.
        xyz_world: (T, K, 3) metres, Z up; NaN where missing.
        sigma_m: (T, K) standard deviation in metres; NaN where missing.
        rate_hz: frames per second. begin_s: seconds of the first frame, in a file of ours of the session, else since the first
            that was recorded, which may have been cut.
        angle_names: A angles. angle_rad: (T, A, 3); NaN where missing.
        subject: who it is. events: in order of time; a file holds the first 255. Both are written, not read.
    """

    names: tuple[str, ...]
    xyz_world: Array
    sigma_m: Array
    rate_hz: float
    angle_names: tuple[str, ...] = ()
    angle_rad: Array = field(default_factory=lambda: np.zeros((0, 0, 3)))
    subject: str = ""
    begin_s: float = 0.0
    events: tuple[C3dEvent, ...] = ()

    def __post_init__(self) -> None:
        if not self.angle_names:
            object.__setattr__(self, "angle_rad", np.zeros((len(self.xyz_world), 0, 3)))
        sizes = frozen_fields(self, {"xyz_world": "T K 3", "sigma_m": "T K", "angle_rad": "T A 3"})
        if (sizes["K"], sizes["A"]) != (len(self.names), len(self.angle_names)):
            raise ShapeError(f"C3dData: {len(self.names)} names, {len(self.angle_names)} angle names; arrays have {sizes}")
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise ShapeError(f"C3dData.rate_hz: expected > 0, got {self.rate_hz}")

    @property
    def t_s(self) -> Array:
        """(T,) seconds of the frames, from `begin_s` on."""
        return self.begin_s + np.arange(len(self.xyz_world)) / self.rate_hz


def write_c3d(path: Path | str, data: C3dData) -> None:
    """Write a C3D file (floating point, no analog channels); raises InputError when the place cannot be written to."""
    path = Path(path)
    labels = [*data.names, *data.angle_names]
    if len(set(labels)) != len(labels):
        raise InputError(f"{path}: names of points and angles must be unique, got {choices(labels)}")
    step_mm = max(_FINEST_RESIDUAL_MM, float(np.nan_to_num(data.sigma_m).max(initial=0)) / _METRES["mm"] / _MOST_STEPS)
    frames, frame_bytes = len(data.xyz_world), len(labels) * POINT_BYTES
    head = _head_of(path, data, labels, step_mm)
    with atomic_file(path) as staged, staged.open("wb") as out:
        out.write(completed_head(path, head, frames, frames * frame_bytes))
        for start in range(0, frames, _PART_FRAMES):
            out.write(_points_of(data, slice(start, start + _PART_FRAMES), step_mm).tobytes())
        out.write(bytes(BLOCK_BYTES - out.tell() % BLOCK_BYTES))


def _head_of(path: Path, data: C3dData, labels: list[str], step_mm: float) -> bytes:
    """Header and parameters, by ezc3d, of a file of one frame: of all that it writes, it keeps several times the memory."""
    file = _described(data, labels, step_mm)
    file["data"]["points"] = np.ones((4, len(labels), 1))
    with TemporaryDirectory() as scratch:
        written = Path(scratch) / "one.c3d"
        try:
            file.write(str(written))
            content = written.read_bytes()
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"{path}: cannot be written ({error})") from None
        # ezc3d writes to a full disk without a word
        if len(content) < BLOCK_BYTES or not BLOCK_BYTES < data_start(content) < len(content):
            folder = Path(scratch).parent
            raise DiskFullError(f"{path}: cannot be written, there is no room in {folder}; set TMPDIR to another folder")
    return content[: data_start(content)]


def _described(data: C3dData, labels: list[str], step_mm: float) -> Any:
    """ezc3d's file of the recording without its points."""
    import ezc3d

    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [data.rate_hz]
    point["LABELS"]["value"] = labels
    point["DESCRIPTIONS"]["value"] = labels
    point["UNITS"]["value"] = ["mm"]
    point["SCALE"]["value"] = np.array([-step_mm])  # negative: stored as floating point
    for group, parameters in _parameters(data).items():
        for name, values in parameters.items():
            file.add_parameter(group, name, values)
            if isinstance(values, list) and isinstance(values[0], int):
                file["parameters"][group][name]["type"] = ezc3d.ezc3d.INT  # it makes floats of them
    return file


def _points_of(data: C3dData, part: slice, step_mm: float) -> Array:
    """(T', K + A, 4) as they are stored: x, y, z, then the residual in steps in the low byte of a word; -1 if missing."""
    angle_deg = np.degrees(data.angle_rad[part])
    values = np.concatenate([data.xyz_world[part] / _METRES["mm"], angle_deg], axis=1)
    residual_mm = np.concatenate([data.sigma_m[part] / _METRES["mm"], np.zeros(angle_deg.shape[:2])], axis=1)
    missing = ~np.isfinite(values).all(axis=-1)
    points = np.empty((*missing.shape, 4), "<f4")
    points[..., :3] = np.where(missing[..., None], 0.0, values)
    points[..., 3] = np.where(missing, -1.0, np.rint(np.nan_to_num(residual_mm) / step_mm))
    return points


def read_c3d(path: Path | str) -> C3dData:
    """Read a C3D file whose world is Z up, as lab systems and `write_c3d` make it, or Y up, where the file states that.

    Points listed under POINT:ANGLES become angles; other kinds (forces, moments, powers) are left out.

    Raises:
        InputError: it cannot be read, holds no points, or names units that are unknown.
    """
    path = Path(path)
    blocks = read_blocks(path)
    point = blocks.parameters.get("POINT", {})
    labels = _labels(path, point, blocks.xyz.shape[1])
    if not labels:
        raise InputError(f"{path}: expected points over time, got none")
    metres = _METRES.get(_text(point, "UNITS"))
    if metres is None:
        raise InputError(f"{path}: POINT:UNITS: expected one of {choices(_METRES)}, got {_text(point, 'UNITS')!r}")
    angles = _listed(point, "ANGLES")
    other = set().union(*(_listed(point, kind) for kind in ("FORCES", "MOMENTS", "POWERS", "SCALARS")))
    is_angle = np.array([label in angles for label in labels])
    is_point = np.array([label not in angles and label not in other for label in labels])
    residual = blocks.residual
    missing = (residual < 0) | ~np.isfinite(blocks.xyz).all(axis=-1)
    points = np.where(missing[..., None], np.nan, blocks.xyz)
    rate_hz = _rate(path, point)
    return C3dData(
        names=tuple(label for label, chosen in zip(labels, is_point, strict=True) if chosen),
        xyz_world=(points[:, is_point] * metres)[..., [2, 0, 1] if _text(point, "Y_SCREEN") == "+Y" else [0, 1, 2]],
        sigma_m=np.where(missing, np.nan, residual * metres)[:, is_point],
        rate_hz=rate_hz,
        begin_s=_begin_s(blocks.parameters.get("POSEFUSE", {}), (blocks.first_frame - 1) / rate_hz),
        angle_names=tuple(label for label, chosen in zip(labels, is_angle, strict=True) if chosen),
        angle_rad=np.radians(points[:, is_angle]),
    )


def _parameters(data: C3dData) -> dict[str, dict[str, Any]]:
    """What a file states beyond its points, by group and name."""
    # the axes on the screen of viewers: X to the right, Z up
    groups: dict[str, dict[str, Any]] = {"POINT": {"X_SCREEN": "+X", "Y_SCREEN": "+Z"}}
    if (frames := len(data.xyz_world)) > LAST_IN_HEADER:
        # where Visual3D, and where Vicon and BTK look for a number that is too large for 16 bits
        groups["POINT"]["LONG_FRAMES"] = [float(frames)]
        words = np.array([frames], "<u4").view("<i2").tolist()
        groups["TRIAL"] = {"ACTUAL_START_FIELD": [1, 0], "ACTUAL_END_FIELD": words}
    if data.angle_names:
        groups["POINT"] |= {"ANGLES": list(data.angle_names), "ANGLE_UNITS": "deg", "TYPE_GROUPS": ["ANGLES", "ANGLE"]}
    subject = data.subject.encode()[:_TEXT_BYTES].decode(errors="ignore")
    if subject:
        groups["SUBJECTS"] = {"USED": [1], "NAMES": [subject], "USES_PREFIXES": [0], "LABEL_PREFIXES": [""]}
    if events := data.events[:_NAMES_PER_PARAMETER]:
        # a time is minutes and seconds; readers add them up
        times = np.array([[0.0, event.t_s] for event in events]).T
        sides, labels = [event.side.title() for event in events], [_EVENT_LABELS[event.kind] for event in events]
        subjects = [subject] * len(events)
        groups["EVENT"] = {"USED": [len(events)], "CONTEXTS": sides, "LABELS": labels, "TIMES": times, "SUBJECTS": subjects}
    groups["MANUFACTURER"] = {"COMPANY": "posefuse", "SOFTWARE": "posefuse", "VERSION_LABEL": __version__}
    return {**groups, "POSEFUSE": {"START_NS": f"{round(data.begin_s * 1e9)}"}}


def _begin_s(group: Group, otherwise_s: float) -> float:
    """Of a file of ours that of the session."""
    try:
        return int(_text(group, "START_NS")) * 1e-9
    except ValueError:
        return otherwise_s


def _labels(path: Path, point: Group, count: int) -> list[str]:
    """A name for each point; LABELS2, LABELS3, ... continue where a parameter's 255 names end."""
    lists = [point.get(f"LABELS{i}" if i > 1 else "LABELS", []) for i in range(1, 2 + count // _NAMES_PER_PARAMETER + 1)]
    labels = [str(label).strip() for names in lists for label in names][:count]
    if len(labels) < count:
        raise InputError(f"{path}: POINT:LABELS: expected the names of {count} points, got {len(labels)}")
    return labels


def _rate(path: Path, point: Group) -> float:
    rates = point.get("RATE", [])
    if not rates or isinstance(rates[0], str) or not 0 < rates[0] < np.inf:
        raise InputError(f"{path}: POINT:RATE: expected a number of Hz > 0, got {rates[0] if rates else 'none'}")
    return float(rates[0])


def _text(group: Group, key: str) -> str:
    return str(group[key][0]).strip() if group.get(key) else ""


def _listed(group: Group, key: str) -> set[str]:
    return {str(name).strip() for name in group.get(key, [])}

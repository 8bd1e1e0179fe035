"""Output ``json``: the whole result as one plain file that any language reads."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, ClassVar

from posefuse.core import Kind, PoseSequence, Recording, Sink
from posefuse.core.arrays import Array
from posefuse.core.poses import point_sigma_m
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.settings import settings

from .facts import provenance

COLUMNS = ("x_m", "y_m", "z_m", "sigma_m", "n_views", "reproj_px", "kind")
_DIGITS = 6
_KINDS = {int(kind): kind.name.lower() for kind in Kind}


@settings
class JsonSink:
    """``pose.json``: provenance, skeleton, then one line per time step; missing keypoints are null."""

    name: ClassVar[str] = "json"

    def build(self) -> Sink:
        """This output, ready."""
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``pose.json``; returns the file made."""
        poses = recording.poses
        head = {
            "format": "posefuse pose",
            "provenance": provenance(recording),
            "world": "right-handed, Z up, metres",
            "skeleton": {"name": poses.skeleton.name, "keypoints": poses.skeleton.keypoints, "bones": poses.skeleton.bones},
            "columns": COLUMNS,
            "kinds": list(_KINDS.values()),
        }
        path, sigma = folder / "pose.json", point_sigma_m(poses.cov_world)
        with atomic_file(path) as staged, staged.open("w", encoding="utf-8") as file:
            file.write(json.dumps(head, indent=1, ensure_ascii=False, default=str).removesuffix("\n}"))
            file.write(',\n "time_steps": [\n')
            for i in range(len(poses)):
                file.write("  " + json.dumps(_instant(poses, sigma, i), allow_nan=False))
                file.write(",\n" if i + 1 < len(poses) else "\n")
            file.write(" ]\n}\n")
        return [path]


def _instant(poses: PoseSequence, sigma: Array, i: int) -> dict[str, Any]:
    """Time step i; sigma (T, N, K) is that of every point."""
    columns = (poses.xyz_world[i], sigma[i], poses.n_views[i], poses.reproj_px[i], poses.kind[i])
    rows = zip(poses.person_id.tolist(), *(column.tolist() for column in columns), strict=True)
    people = {str(person): [_keypoint(*one) for one in zip(*of_person, strict=True)] for person, *of_person in rows}
    return {"t_s": round(int(poses.t_ns[i]) / 1e9, 9), "people": people}


def _keypoint(xyz: list[float], sigma_m: float, n_views: int, reproj_px: float, kind: int) -> list[Any] | None:
    if not all(map(math.isfinite, xyz)):
        return None
    return [*map(_number, xyz), _number(sigma_m), n_views, _number(reproj_px), _KINDS[kind]]


def _number(value: float) -> float | None:
    return round(value, _DIGITS) if math.isfinite(value) else None

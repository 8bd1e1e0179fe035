"""Output ``json``: the whole result as one plain file that any language reads."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from posefuse.core import Kind, Pose3D, Recording, Sink
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.settings import settings

from .facts import provenance

COLUMNS = ("x_m", "y_m", "z_m", "sigma_m", "n_views", "reproj_px", "kind")
_DIGITS = 6


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
            "kinds": [kind.name.lower() for kind in Kind],
        }
        path = folder / "pose.json"
        with atomic_file(path) as staged, staged.open("w", encoding="utf-8") as file:
            file.write(json.dumps(head, indent=1, ensure_ascii=False, default=str).removesuffix("\n}"))
            file.write(',\n "time_steps": [\n')
            for i in range(len(poses)):
                file.write("  " + json.dumps(_instant(poses.at(i)), allow_nan=False))
                file.write(",\n" if i + 1 < len(poses) else "\n")
            file.write(" ]\n}\n")
        return [path]


def _instant(pose: Pose3D) -> dict[str, Any]:
    people = {str(person): [_keypoint(pose, n, k) for k in range(len(pose.skeleton))] for n, person in enumerate(pose.person_id)}
    return {"t_s": round(pose.t_ns / 1e9, 9), "people": people}


def _keypoint(pose: Pose3D, n: int, k: int) -> list[Any] | None:
    xyz = pose.xyz_world[n, k]
    if not np.isfinite(xyz).all():
        return None
    sigma_m = float(np.trace(pose.cov_world[n, k]) / 3) ** 0.5
    plain = [_number(value) for value in (*xyz, sigma_m)]
    return [*plain, int(pose.n_views[n, k]), _number(pose.reproj_px[n, k]), Kind(int(pose.kind[n, k])).name.lower()]


def _number(value: float) -> float | None:
    return round(float(value), _DIGITS) if math.isfinite(value) else None

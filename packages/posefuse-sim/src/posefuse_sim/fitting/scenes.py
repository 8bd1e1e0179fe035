"""People to fit detectors on: simulated, known exactly, bodies and motions of their own.

Bodies, motions and cameras are drawn for fits alone; none of them appears in a reported measurement (bodies of random seeds 7000
to 7207).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from posefuse.core.arrays import Array
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.settings import settings_from_mapping

FLOORS = ("wood", "concrete", "tiles", "plain")
DURATION_S, RATE_HZ = 8.0, 2.5
_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
Range = tuple[Sequence[float], Sequence[float]]
# least and most degrees of legs (abduction, flexion, knee) and arms (abduction, flexion, turn about the vertical, elbow): all
# joints through most of their ranges; and standing with arms raised. Eight scenes of either, of bodies of their own
MOVES: tuple[tuple[Range, Range], ...] = (
    (((0, -20, 2), (25, 60, 80)), ((5, -40, -60, 2), (140, 120, 60, 120))),
    (((0, -8, 1), (14, 8, 12)), ((45, -20, -30, 1), (130, 35, 30, 60))),
)
SCENES_EACH = 8
MOTIONS: list[dict[str, Any]] = [
    {"kind": "squat", "period_s": 5.3},
    {"kind": "reach", "side": "left", "period_s": 1.9},
    {"kind": "walk", "path": {"shape": "line", "start_m": [-1.6, -0.9], "end_m": [1.5, 1.1]}, "speed_mps": 0.8},
    {"kind": "idle", "sway": 2.0},
    {"kind": "wave", "side": "left", "period_s": 2.3},
    {"kind": "reach", "side": "right", "period_s": 2.3},
    {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.0, "clockwise": True}, "speed_mps": 0.7},
    {"kind": "squat", "period_s": 3.7, "knee_flexion_deg": 115},
]


def everyday_scene(i: int) -> dict[str, Any]:
    """One scene: its own body, motion, room, clutter and cameras."""
    rng = np.random.default_rng(90_000 + i)
    motion = dict(MOTIONS[i % len(MOTIONS)])
    if motion["kind"] != "walk":
        motion |= {"position_m": rng.uniform(-0.6, 0.6, 2).round(2).tolist(), "heading_deg": float(rng.integers(0, 360))}
    clutter = [{"kind": "clutter", "count": 7, "area_m": [6, 6], "keep_clear_m": 0.9, "most_height_m": 1.3}] if i % 3 == 1 else []
    size_px = [[640, 480], [1280, 720]][i % 2]
    return _scene(i, rng, 500, {"body": {"random_seed": 7000 + i}, "motion": motion}, size_px, (5.5, 75)) | {"occluders": clutter}


def moving_scene(i: int, motion_file: Path) -> dict[str, Any]:
    """One scene of a person who moves all joints."""
    body = {"random_seed": 7100 + 100 * (i // SCENES_EACH) + i % SCENES_EACH}
    person = {"body": body, "motion": {"kind": "trc", "file": str(motion_file)}}
    return _scene(i, np.random.default_rng(91_000 + i), 600, person, [640, 480], (5.2, 72))


def _scene(
    i: int, rng: np.random.Generator, seed: int, person: dict[str, Any], size_px: list[int], most: tuple[float, int]
) -> dict[str, Any]:
    """One person before four cameras. most: radius of their circle, m, and angle that they see."""
    cameras = {
        "kind": "ring",
        "count": 4,
        "radius_m": round(rng.uniform(3.2, most[0]), 2),
        "height_m": round(rng.uniform(1.0, 2.7), 2),
        "first_angle_deg": float(rng.integers(0, 90)),
        "image": {"size_px": size_px, "horizontal_fov_deg": float(rng.integers(58, most[1]))},
        "sensor": {"noise_dn": 1.5},
    }
    return {
        "duration_s": DURATION_S,
        "rate_hz": RATE_HZ,
        "seed": seed + i,
        "cameras": cameras,
        "people": [person],
        "room": {"floor": FLOORS[i % 4], "walls": ("office", "plain")[i // 2 % 2], "brightness": round(rng.uniform(0.7, 1.2), 2)},
        "record": {"kind": "jpeg", "quality": 90},
    }


def smooth_path(rng: np.random.Generator, low: Sequence[float], high: Sequence[float], t_s: Array) -> Array:
    """(T, n) angles in radians through a random pose every 0.8 s, from limits (n,) in degrees."""
    knots = np.arange(0.0, DURATION_S + 1.6, 0.8)
    return np.asarray(np.deg2rad(PchipInterpolator(knots, rng.uniform(low, high, (len(knots), len(low))))(t_s)))


def moving(seed: int, legs: Range, arms: Range) -> TrcData:
    """Keypoints of a person who stays in one place and moves trunk, legs and arms between limits.

    Rest: +X ahead, +Y left, +Z up, arms down.
    """
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, DURATION_S + 0.4, 1 / 30)
    points: dict[str, Array] = {}
    first, last = rng.uniform(0, 2 * np.pi, 2)
    turn = Rotation.from_euler("z", np.linspace(first, last, len(t_s))[:, None])
    trunk = turn * Rotation.from_euler("zyx", smooth_path(rng, (-25, -10, -12), (25, 25, 12), t_s))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip = turn.apply([0.0, sign * 0.09, 0.0])
        # abduction, flexion; then the bend of the knee
        leg = smooth_path(rng, *legs, t_s)
        thigh = turn * Rotation.from_euler("xy", np.stack([sign * leg[:, 0], -leg[:, 1]], axis=-1))
        shank = thigh * Rotation.from_euler("y", leg[:, 2:])
        knee = hip + thigh.apply([0, 0, -0.42])
        ankle = knee + shank.apply([0, 0, -0.4])
        shoulder = trunk.apply([0, sign * 0.18, 0.5])
        arm = smooth_path(rng, *arms, t_s)
        upper = trunk * Rotation.from_euler("yxz", np.stack([-arm[:, 1], sign * arm[:, 0], arm[:, 2]], axis=-1))
        lower = upper * Rotation.from_euler("y", -arm[:, 3:])
        elbow = shoulder + upper.apply([0, 0, -0.29])
        wrist = elbow + lower.apply([0, 0, -0.26])
        points |= {f"{side}_{name}": xyz for name, xyz in zip(_JOINTS, (shoulder, elbow, wrist, hip, knee, ankle), strict=True)}
    xyz = np.stack(list(points.values()), axis=1) + [0, 0, 0.9]
    return TrcData(names=tuple(points), t_s=t_s, xyz_world=xyz, rate_hz=30.0)


def render_everyday(out: Path, count: int, say: Callable[[str], None]) -> list[Path]:
    """Draw the scenes that are not there yet; minutes, and may be interrupted and resumed."""
    return [_rendered(out / f"scene{i:02d}", everyday_scene(i), say) for i in range(count)]


def render_moving(out: Path, count: int, say: Callable[[str], None]) -> list[Path]:
    """The same of people who move all joints about, at most `SCENES_EACH` of each of the `MOVES`."""
    out.mkdir(parents=True, exist_ok=True)
    folders = []
    for i in range(min(count, SCENES_EACH * len(MOVES))):
        motion_file = out.absolute() / f"motion{i:02d}.trc"
        if not motion_file.exists():
            write_trc(motion_file, moving(i, *MOVES[i // SCENES_EACH]))
        folders.append(_rendered(out / f"scene{i:02d}", moving_scene(i, motion_file), say))
    return folders


def is_rendered(folder: Path) -> bool:
    """Whether a scene's folder is complete."""
    return (folder / "truth" / "truth.npz").exists()


def _rendered(folder: Path, scene: dict[str, Any], say: Callable[[str], None]) -> Path:
    if not is_rendered(folder):
        from posefuse_sim.scene import Scene
        from posefuse_sim.session import simulate

        simulate(settings_from_mapping(scene, Scene, where=folder.name), folder, processes=1)
        say(f"{folder.name}: rendered")
    return folder

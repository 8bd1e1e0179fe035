"""The scenes of the paper's experiments, and other bodies and ways to check them with.

Bodies, motions and seeds here are used in no fit: fits draw bodies of random seeds 7000 to 7207 (`bench/fit_*.py`).
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from posefuse.foundation import settings_from_mapping
from posefuse_sim import Scene

# other bodies, ways and rooms: the tables must agree on them within their spread
CHECK_SEEDS = (21, 22, 23)
PATHS = ("circle", "back_forth", "sideways")
HALF_HIDDEN = ("free", "screen", "false_arm")
# by the screens, from the two cameras before the body
HIDDEN_JOINTS = ("left_shoulder", "left_elbow", "left_wrist", "left_hip", "left_knee", "left_ankle")

_OCCLUDERS = (
    {"kind": "wall", "from_m": [1.6, -0.4], "to_m": [1.3, 1.0], "height_m": 1.3},
    {"kind": "wall", "from_m": [-0.6, 1.7], "to_m": [-1.5, 1.1], "height_m": 1.5},
    {"kind": "box", "position_m": [-1.7, -0.7, 0.6], "size_m": [0.5, 0.7, 1.2], "yaw_deg": 30},
    {"kind": "box", "position_m": [0.5, -1.7, 0.5], "size_m": [0.8, 0.4, 1.0], "yaw_deg": -10},
    {"kind": "clutter", "count": 4, "area_m": [6.0, 6.0], "keep_clear_m": 1.7, "most_height_m": 1.4},
)
# each hides the left half of a person at the origin who faces +X from one of the two cameras before them
_SCREENS = (
    {"kind": "wall", "from_m": [0.49, 0.57], "to_m": [-0.01, 1.0], "height_m": 2.0},
    {"kind": "wall", "from_m": [0.49, -0.57], "to_m": [0.99, -0.14], "height_m": 2.0},
)
# an arm in the colour of the shirt, and a hand, hanging on each of the screens
_FALSE_ARMS = tuple(
    {"kind": "box", "position_m": [*place, z_m], "size_m": [0.08, 0.08, length_m], "yaw_deg": yaw_deg, "colour": colour}
    for place, yaw_deg in (([0.39, 0.78], 139.4), ([0.71, -0.49], 40.6))
    for z_m, length_m, colour in ((1.12, 0.56, [0.70, 0.15, 0.15]), (0.76, 0.16, [0.85, 0.65, 0.55]))
)
_WAYS: Mapping[str, Mapping[str, Any]] = {
    "circle": {"speed_mps": 0.97, "path": {"shape": "circle", "radius_m": 1.5}},
    "back_forth": {"speed_mps": 0.97, "path": {"shape": "back_forth", "start_m": [-1.5, -0.4], "end_m": [1.5, -0.4]}},
    "sideways": {
        "speed_mps": 0.6,
        "path": {"shape": "back_forth", "start_m": [-1.5, 0.0], "end_m": [1.5, 0.0], "facing": "sideways"},
    },
}


def static_scene(occluded: bool, seed: int = 1, duration_s: float = 3.0) -> Scene:
    """T-pose among eight cameras on a circle of 4.5 m; with walls, boxes and clutter if `occluded`.

    Seed 1 has the default body; every other seed a body and clutter of its own. Nothing moves, so time steps differ by sensor
    noise and coding alone: a few seconds are enough, and more bodies help more than more time.
    """
    return _scene(
        {
            "duration_s": duration_s,
            "rate_hz": 10,
            "seed": seed,
            "cameras": ring(8, 60),
            "people": [{**_body(seed), "motion": {"kind": "tpose"}}],
            "occluders": list(_OCCLUDERS) if occluded else [],
        }
    )


def walking_scene(seed: int = 1, duration_s: float = 60.0) -> Scene:
    """A random walk at 1.35 m/s among four cameras on a circle of 4.5 m; bodies as in `static_scene`."""
    motion = {"kind": "walk", "speed_mps": 1.35, "path": {"shape": "random", "low_m": [-1.8, -1.8], "high_m": [1.8, 1.8]}}
    return _scene(
        {
            "duration_s": duration_s,
            "rate_hz": 30,
            "seed": seed,
            "cameras": ring(4, 66),
            "people": [{**_body(seed), "motion": motion}],
        }
    )


def path_scene(path: str, duration_s: float = 40.0, rate_hz: float = 15.0) -> Scene:
    """One of `PATHS`: the paper's circle of 3 m, 3 m back and forth, 3 m sideways, at 3.5 km/h and less sideways.

    Drift is error over way walked, which the rate does not change: half of a camera's usual rate saves half the rendering.
    """
    return _scene(
        {
            "duration_s": duration_s,
            "rate_hz": rate_hz,
            "seed": 1,
            "cameras": ring(4, 66),
            "people": [{"motion": {"kind": "walk", **_WAYS[path]}}],
        }
    )


def half_hidden_scene(case: str, duration_s: float = 10.0, rate_hz: float = 15.0) -> Scene:
    """One of `HALF_HIDDEN`: a person waves with the left arm among cameras in the corners of the paper's room of 6 m x 7 m.

    Before the left half of the body stands nothing (``free``), screens that hide it from two of the four cameras
    (``screen``), or those with a false arm on each in the colour of the shirt (``false_arm``).
    """
    image = {"size_px": [640, 480], "horizontal_fov_deg": 66}
    places = ((3.0, 3.5), (-3.0, 3.5), (-3.0, -3.5), (3.0, -3.5))
    corners = [{"name": f"cam{i:02d}", "position_m": [*xy, 2.2], "image": image} for i, xy in enumerate(places)]
    return _scene(
        {
            "duration_s": duration_s,
            "rate_hz": rate_hz,
            "seed": 1,
            "cameras": {"kind": "list", "cameras": corners},
            "people": [{"motion": {"kind": "wave", "side": "left", "period_s": 1.8}}],
            "occluders": [*(_SCREENS if case != "free" else ()), *(_FALSE_ARMS if case == "false_arm" else ())],
        }
    )


def scene_name(name: str, scene: Scene) -> str:
    """A folder name that changes with anything in the scene."""
    return f"{name}-{hashlib.sha256(json.dumps(asdict(scene), sort_keys=True).encode()).hexdigest()[:10]}"


def ring(count: int, fov_deg: float) -> dict[str, Any]:
    """The cameras of a scene: on a circle of 4.5 m, of 640 x 480 px."""
    image = {"size_px": [640, 480], "horizontal_fov_deg": fov_deg}
    return {"kind": "ring", "count": count, "radius_m": 4.5, "height_m": 2.2, "image": image}


def _body(seed: int) -> dict[str, Any]:
    return {} if seed == 1 else {"body": {"random_seed": seed}}


def _scene(content: Mapping[str, Any]) -> Scene:
    return settings_from_mapping(content, Scene, where="experiment")

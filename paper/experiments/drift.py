"""Three paths, beside a simulated inertial suit: what drifts and what does not (the paper's comparison with a suit)."""

from __future__ import annotations

from typing import Any

import numpy as np

from paper.scenes.drift import drift
from paper.scenes.inertial import SENSORS, SuitNoise, suit_joints
from paper.scenes.page import Line, Page, plot
from paper.scenes.scenes import PATHS, path_scene
from posefuse.core.arrays import Array
from posefuse.core.skeleton import PAPER14, pick_keypoints
from posefuse.evaluation.metrics import true_xyz_at

from .moments import pictures
from .runs import Context, Outcome, run_scene

SUMMARY = "three paths: place of the pelvis over time, beside a simulated inertial suit"
_QUICK_S, _FULL_S = 2.0, 40.0
_SUIT_SEEDS = 20
_PELVIS = PAPER14.keypoints.index("mid_hip")


def run(context: Context) -> Outcome:
    """Pelvis of all three paths from cameras and from the suit."""
    page = Page("Drift: cameras beside an inertial suit")
    noise = SuitNoise()
    page.section(
        "The suit",
        f"{SENSORS} sensors simulated from the truth; it chains segments from the standing foot (zero-velocity updates). Errors "
        "as published for such sensors, see paper/scenes/inertial.py. Drawn: the run of median drift of "
        f"{_SUIT_SEEDS} suits.",
    )
    page.facts({name: f"{value:g}" for name, value in vars(noise).items()})
    figures: dict[str, Any] = {"paths": {}, "suit": vars(noise), "suits": _SUIT_SEEDS}
    for path in PATHS:
        done = run_scene(f"drift-{path}", path_scene(path, _QUICK_S if context.quick else _FULL_S), context)
        poses, truth = done.recording.poses, done.truth
        inside = (poses.t_ns >= truth.t_ns[0]) & (poses.t_ns <= truth.t_ns[-1])
        t_ns = poses.t_ns[inside]
        true = pick_keypoints(true_xyz_at(truth, t_ns)[:, 0], truth.skeleton, ["mid_hip"])[:, 0]
        seen = pick_keypoints(poses.xyz_world[inside, 0], poses.skeleton, ["mid_hip"])[:, 0]
        exact = pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, ["mid_hip"])[:, 0]
        suits = [suit_joints(truth, noise, seed)[:, _PELVIS] for seed in range(_SUIT_SEEDS)]
        ends = [drift(suit, exact).end_m for suit in suits]
        suit = suits[int(np.argsort(ends)[len(ends) // 2])]
        vision = drift(seen, true)
        worn = drift(suit, exact)
        figures["paths"][path] = {
            "distance_m": float(vision.walked_m[-1]),
            "vision": {
                "drift_mm_per_m": vision.mm_per_m,
                "end_m": vision.end_m,
                "mean_mm": 1000 * float(np.nanmean(vision.error_m)),
            },
            "suit": {
                "drift_mm_per_m": worn.mm_per_m,
                "end_m": worn.end_m,
                "end_m_of_all": [float(np.min(ends)), float(np.max(ends))],
            },
        }
        rate_hz = 1e9 / np.median(np.diff(truth.t_ns))
        page.section(
            path.replace("_", " "),
            f"{vision.walked_m[-1]:.0f} m in {t_ns[-1] / 1e9:.0f} s, cameras at {rate_hz:.0f} Hz (drift is error over way "
            "walked, so their rate does not matter).",
        )
        page.plots(_drawn(true, seen, exact, suit, (t_ns - t_ns[0]) / 1e9, (truth.t_ns - truth.t_ns[0]) / 1e9, vision, worn))
        page.pictures(pictures(done, 0, [len(poses) // 3, 2 * len(poses) // 3], 380))
    rows = [
        [path.replace("_", " "), one["distance_m"], one["vision"]["drift_mm_per_m"], one["suit"]["drift_mm_per_m"],
         1000 * one["vision"]["end_m"], 1000 * one["suit"]["end_m"]]
        for path, one in figures["paths"].items()
    ]  # fmt: skip
    page.section(
        "Summary", "Level distance of the pelvis from the truth; drift is the slope of that distance over the way walked."
    )
    page.table(["path", "walked m", "cameras mm/m", "suit mm/m", "cameras: end mm", "suit: end mm"], rows)
    return Outcome(files=figures, failed=page)


def _drawn(true: Array, seen: Array, exact: Array, suit: Array, t_s: Array, suit_s: Array, vision: Any, worn: Any) -> list[str]:
    over_time = [
        plot(
            f"{name} over time",
            "s",
            "m",
            [Line("truth", suit_s, exact[:, a]), Line("cameras", t_s, seen[:, a]), Line("suit", suit_s, suit[:, a])],
        )
        for a, name in enumerate("xy")
    ]
    way = [Line("truth", true[:, 0], true[:, 1]), Line("cameras", seen[:, 0], seen[:, 1]), Line("suit", suit[:, 0], suit[:, 1])]
    error = [
        Line("cameras", vision.walked_m, 1000 * vision.error_m, colour=1),
        Line("suit", worn.walked_m, 1000 * worn.error_m, colour=2),
    ]
    return [plot("From above", "x, m", "m", way, equal=True), *over_time, plot("Error", "m walked", "mm", error, from_zero=True)]

"""The whole-body fit on rendered people who are used in no fit and no choice: `track --body off` and `--body on` side by side.

    python bench/body_held_out.py --keep DIR [--only walk T-pose] [--network blazepose_best] [--bodies 12] [--seeds 1,2,3]

One body per seed. The first run draws the seeds by chance and keeps them in DIR, so no one knows them before. DIR also keeps
the rendered scenes, and out/bench what was tracked per version of the code, so that work can be stopped and continued at any
time: run the same command again. Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from bodies import HIDDEN, SCENES, scene_of, seeds_of
from body_figures import ENDS, FLEXIONS, figures
from harness import OUT, Row, Use, answer, arguments, medians, note, rendered, tracked, truth_of

from paper.scenes.scenes import HIDDEN_JOINTS
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import PAPER14
from posefuse.detection.build import network_settings
from posefuse.pipeline.config import changed_config
from posefuse.pipeline.solve import config_of, solve_again

WAYS = ("off", "on")
Figures = dict[str, dict[str, float]]


def measured(session: Path, network: str) -> Figures:
    """Figures without and with the fit."""
    off, truth = tracked(session, body="off", **network_settings(network or None)), truth_of(session)
    return {way: figures(solve_again(off, changed_config(config_of(off.provenance), {"body": way})).poses, truth) for way in WAYS}


def rows_of(name: str, bodies: list[Figures]) -> list[tuple[Row, Row]]:
    """Means over the bodies of a scene, without and with the fit: of positions, and of angles and lengths."""
    joints, rows = HIDDEN_JOINTS if name in HIDDEN else PAPER14.keypoints, []
    mm = {way: np.array([[one[way][f"{joint} mm"] for joint in joints] for one in bodies]) for way in WAYS}
    better = int((np.nanmean(mm["on"], axis=1) < np.nanmean(mm["off"], axis=1)).sum())
    for way in WAYS:
        means, about = medians([one[way] for one in bodies], np.nanmean), {"row": name, "body": way}
        of_joints = {"mean_mm": float(np.nanmean(mm[way])), "worst_joint_mm": float(np.nanmean(mm[way], axis=0).max())}
        counted = {"bodies": len(bodies), "better": better, **of_joints, "nees": means["nees"], "skate_mm": means["skate_mm"]}
        held = [{name: means[f"{name}{of} held"] for name in names} for names, of in ((ENDS, ""), (FLEXIONS, " angle"))]
        degrees = {f"{joint}_deg": means[f"{joint} deg"] for joint in FLEXIONS}
        lengths = {segment: means[f"{segment} off"] for segment in SEGMENT_ENDS}
        rows.append(({**about, **counted, "within_90": held[0]}, {**about, **degrees, "within_90": held[1], **lengths}))
    return rows


def main() -> None:
    args = arguments(
        __doc__, keep=OUT / "held_out", only=dict.fromkeys(SCENES), network="", bodies=12, seeds="", rate_hz=float, seconds=float,
    )  # fmt: skip
    changes = {"rate_hz": args.rate_hz, "duration_s": args.seconds}
    changes = {name: value for name, value in changes.items() if value is not None}
    found: dict[str, list[Figures]] = {name: [] for name in args.only}
    for name, seed in product(args.only, seeds_of(args.keep, args.bodies, args.seeds)):
        session = rendered(replace(scene_of(name, seed), **changes), args.keep / f"{seed}-{name}", Use.REPORT)
        found[name].append(measured(session, args.network))
        note(f"{name} {seed}: measured")
    positions, angles = zip(*(row for name, bodies in found.items() for row in rows_of(name, bodies)), strict=True)
    title = "Flexion RMSE, degrees, and the share by which segment lengths are off"
    answer(args, {"Held-out bodies": positions, title: angles})


if __name__ == "__main__":
    main()

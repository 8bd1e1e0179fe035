"""2D networks side by side: on rendered people who are used in no fit and no choice, on real footage, and their time per image.

    python bench/networks.py --keep DIR [--networks blazepose_full movenet_thunder ...] [--bodies 4] [--seconds 2] [--seeds 1,2]

One body per seed, in several motions. The first run draws the seeds by chance and keeps them in DIR with the rendered scenes, so
work can be stopped and continued: run the same command again. Networks are fetched before (`posefuse models`). Tables on stderr,
one JSON object on stdout.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from bodies import scene_of, seeds_of
from body_figures import ENDS
from detect import CORES, SIZES_WH, measure
from harness import DATA, JOINTS, OUT, Row, Use, answer, arguments, note, rendered, tracked, truth_of
from real_footage import LIMBS, limbs_of, row

from posefuse.core.skeleton import SIDES
from posefuse.detection.build import network_settings
from posefuse.evaluation.metrics import joint_errors, typical_nees

NETWORKS = ("blazepose_full", "movenet_thunder", "movenet_lightning")
MOTIONS = ("walk", "reach", "squat")


def by_end(of: dict[str, float]) -> dict[str, float]:
    """Means of both sides."""
    return {end: float(np.mean([of[f"{side}_{end}"] for side in SIDES])) for end in ENDS}


def on_rendered(network: str, sessions: list[Path]) -> Row:
    """Means over people and motions."""
    found, nees = [], []
    for session in sessions:
        poses, truth = tracked(session, **network_settings(network)).poses, truth_of(session)
        errors = joint_errors(poses, truth)
        found.append({"mean_mm": errors.mpjpe_mm, **by_end(dict(zip(errors.joints, errors.mean_mm.tolist(), strict=True)))})
        nees.append(typical_nees(poses, truth, JOINTS))
        note(f"{network}: {session.name}")
    return {
        "network": network,
        **{name: float(np.mean([one[name] for one in found])) for name in found[0]},
        "NEES": np.mean(nees),
    }


def on_footage(network: str, data: Path) -> Row:
    """Medians next to the other pipeline."""
    recording = tracked(data, **network_settings(network))
    got = row(recording.poses, recording, limbs_of(data))
    return {"network": network, "mean_mm": got["mean_mm"], **by_end({name: got[name] for name in LIMBS})}


def main() -> None:
    args = arguments(
        __doc__, keep=OUT / "networks", networks=NETWORKS, bodies=4, seconds=2.0, seeds="",
        data=DATA / "pose2sim_single", repeat=50,
    )  # fmt: skip
    sessions = []
    for seed in seeds_of(args.keep, args.bodies, args.seeds):
        for motion in MOTIONS:
            scene = replace(scene_of(motion, seed), duration_s=args.seconds)
            sessions.append(rendered(scene, args.keep / f"{seed}-{motion}", Use.REPORT))
            note(f"{sessions[-1].name}: rendered")
    tables = {f"mm, {len(sessions)} scenes of people used in no fit": [on_rendered(name, sessions) for name in args.networks]}
    if args.data.is_dir():
        tables["Real footage next to Pose2Sim on OpenPose, mm (medians)"] = [
            on_footage(name, args.data) for name in args.networks
        ]
    tables["Time per image, four views at once"] = [
        measure(name, CORES, SIZES_WH[0], True, args.repeat) for name in args.networks
    ]
    answer(args, tables)


if __name__ == "__main__":
    main()

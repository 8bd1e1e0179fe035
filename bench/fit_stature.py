"""Fit what shares of a person's height their limbs are as the network marks them, and judge the height on bodies left out.

    python bench/fit_stature.py render OUT    draw people of many sizes who walk (about a minute each; resumes)
    python bench/fit_stature.py fit OUT       find them, measure their limbs in the true rig, fit, judge

Bodies are drawn by random seeds (both sexes, 20 to 70 years, 1.5 to 1.95 m) that no reported measurement has. Shares come from
one half of them; bias and standard deviation of the height from the other. JSON on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from paper.scenes.scenes import walking_scene
from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.person.scale import KnownLength, limb_lengths_m, stature_m
from posefuse.calibration.person.views import person_views
from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS
from posefuse.detection.build import DetectorChoice
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import person_in_videos
from posefuse.simulation import SessionPaths, simulate
from posefuse.simulation.body.body import completed_shape
from posefuse.simulation.scene import read_scene

FITTED, LEFT_OUT = range(7300, 7305), range(7305, 7310)
SECONDS, RATE_HZ = 6.0, 15.0


def session(out: Path, seed: int) -> SessionPaths:
    return SessionPaths(out / f"{seed}-walk")


def render(out: Path) -> None:
    for seed in (*FITTED, *LEFT_OUT):
        paths = session(out, seed)
        if not paths.rig.exists():
            simulate(replace(walking_scene(seed, SECONDS), rate_hz=RATE_HZ), paths.folder)


def keypoints(paths: SessionPaths) -> tuple[Skeleton, Array]:
    """The person's keypoints (T, K, 3) in the true rig, as the default network marks them."""
    rig = read_rig(paths.rig)
    videos = {camera.name: paths.video(camera.name) for camera in rig}
    views = person_views(person_in_videos(videos, rig, KnownLength(stature_m=1.7), DetectorChoice()).tracks)
    xy = np.where(views.usable[..., None], views.xy_img, np.nan)
    xyz = triangulate_linear(rig, xy.reshape(len(rig), -1, 2)).reshape(*xy.shape[1:3], 3)
    return views.skeleton, xyz


def height_m(paths: SessionPaths) -> float:
    body = completed_shape(read_scene(paths.scene).people[0].body)
    assert body.height_m is not None
    return float(body.height_m)


def fit(out: Path) -> dict:
    seen = {seed: (height_m(session(out, seed)), *keypoints(session(out, seed))) for seed in (*FITTED, *LEFT_OUT)}
    shares = {seed: limb_lengths_m(skeleton, xyz) / height for seed, (height, skeleton, xyz) in seen.items()}
    fitted = np.mean([shares[seed] for seed in FITTED], axis=0)
    # as the new shares would give it, and as those of the package do
    new = {seed: float(shares[seed].sum() / fitted.sum()) for seed in seen}
    now = {seed: stature_m(skeleton, xyz) / height for seed, (height, skeleton, xyz) in seen.items()}
    for seed, (height, _, _) in seen.items():
        print(f"{seed} {height:.3f} m: {new[seed]:.3f} of it by the fit, {now[seed]:.3f} by the package", file=sys.stderr)
    return {
        "shares": dict(zip(LIMB_ENDS, np.round(fitted, 4).tolist(), strict=True)),
        "left_out": of(new), "left_out_by_the_package": of(now), "heights_m": [round(seen[seed][0], 3) for seed in LEFT_OUT],
    }  # fmt: skip


def of(ratio: dict[int, float]) -> dict[str, float]:
    off = 100 * (np.array([ratio[seed] for seed in LEFT_OUT]) - 1)
    return {"bodies": len(off), "bias_percent": float(off.mean()), "sd_percent": float(off.std(ddof=1)),
            "worst_percent": float(np.abs(off).max())}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "fit"))
    parser.add_argument("out", type=Path)
    arguments = parser.parse_args()
    if arguments.step == "render":
        render(arguments.out)
    else:
        print(json.dumps(fit(arguments.out), indent=2))


if __name__ == "__main__":
    main()

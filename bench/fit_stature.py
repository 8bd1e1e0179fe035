"""Fit what shares of a person's height their limbs are as the network marks them, and judge the height on bodies left out.

    python bench/fit_stature.py OUT

People of many sizes who walk are drawn into OUT (about a minute each; resumes). Bodies are drawn by random seeds (both sexes,
20 to 70 years, 1.5 to 1.95 m) that no reported measurement has. Shares come from one half of them; bias and standard deviation
of the height from the other. JSON on stdout.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from calibrate_person import height_of
from harness import Use, answer, arguments, rendered

from paper.scenes.scenes import walking_scene
from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.person.scale import KnownLength, limb_lengths_m, stature_m
from posefuse.calibration.person.views import person_views
from posefuse.core import Skeleton
from posefuse.core.skeleton import LIMB_ENDS
from posefuse.detection.build import DetectorChoice
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import person_in_videos
from posefuse_sim import SessionPaths

FITTED, LEFT_OUT = range(7300, 7305), range(7305, 7310)
SECONDS, RATE_HZ = 6.0, 15.0


def session(out: Path, seed: int) -> Path:
    return rendered(replace(walking_scene(seed, SECONDS), rate_hz=RATE_HZ), out / f"{seed}-walk", Use.FIT, processes=None)


def keypoints(session: Path) -> tuple[Skeleton, np.ndarray]:
    """The person's keypoints (T, K, 3) in the true rig, as the default network marks them."""
    rig = read_rig(SessionPaths(session).rig)
    videos = {camera.name: SessionPaths(session).video(camera.name) for camera in rig}
    views = person_views(person_in_videos(videos, rig, KnownLength(stature_m=1.7), DetectorChoice()).tracks)
    xy = np.where(views.usable[..., None], views.xy_img, np.nan)
    return views.skeleton, triangulate_linear(rig, xy.reshape(len(rig), -1, 2)).reshape(*xy.shape[1:3], 3)


def of(ratio: dict[int, float]) -> dict[str, float]:
    off = 100 * (np.array([ratio[seed] for seed in LEFT_OUT]) - 1)
    spread = {"sd_percent": float(off.std(ddof=1)), "worst_percent": float(np.abs(off).max())}
    return {"bodies": len(off), "bias_percent": float(off.mean()), **spread}


def main() -> None:
    args = arguments(__doc__, positional=("out",), out=Path)
    sessions = {seed: session(args.out, seed) for seed in (*FITTED, *LEFT_OUT)}
    seen = {seed: (height_of(SessionPaths(one)), *keypoints(one)) for seed, one in sessions.items()}
    shares = {seed: limb_lengths_m(skeleton, xyz) / height for seed, (height, skeleton, xyz) in seen.items()}
    fitted = np.mean([shares[seed] for seed in FITTED], axis=0)
    # as the new shares would give it, and as those of the package do
    new = {seed: float(shares[seed].sum() / fitted.sum()) for seed in seen}
    now = {seed: stature_m(skeleton, xyz) / height for seed, (height, skeleton, xyz) in seen.items()}
    each = [{"seed": seed, "height_m": seen[seed][0], "by the fit": new[seed], "by the package": now[seed]} for seed in seen]
    judged = [{"height": "by the fit", **of(new)}, {"height": "by the package", **of(now)}]
    answer(args, {"Shares of the height": each, "Bodies left out": judged}, shares=dict(zip(LIMB_ENDS, fitted, strict=True)))


if __name__ == "__main__":
    main()

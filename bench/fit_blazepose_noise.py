"""Fit the noise model of the BlazePose landmark network on rendered people, whose keypoints are known exactly.

    python bench/fit_blazepose_noise.py render OUT     draw the scenes (minutes; may be interrupted and resumed)
    python bench/fit_blazepose_noise.py fit OUT [--card NAME]
                                                       fit, print the calibration by score, write the model file

Bodies, motions and cameras are drawn for this purpose alone; none of them appears in a reported measurement.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from posefuse.core import SKELETONS, Region
from posefuse.core.skeleton import mirror_name
from posefuse.detection import fetch, read_card, region_from_keypoints
from posefuse.detection.blazepose.landmarks import landmarks_from_outputs
from posefuse.detection.blazepose.network import BlazePoseNetwork
from posefuse.detection.blazepose.noise import landmark_noise_features
from posefuse.detection.regions import crop_from_img, square_crop
from posefuse.evaluation.fitting import is_rendered, render_everyday
from posefuse.evaluation.fitting.keypoint_noise import fit_log_sigma
from posefuse.formats.truth import read_truth
from posefuse.foundation.places import default_cache_dir

BODY, TRUE_BODY = SKELETONS["blazepose33"], SKELETONS["anatomical23"]
SYNONYMS = {"left_big_toe": "left_foot_index", "right_big_toe": "right_foot_index"}
THEIR_NAMES = [name for name in TRUE_BODY.keypoints if SYNONYMS.get(name, name) in BODY.keypoints]
THEIRS = TRUE_BODY.indices(THEIR_NAMES)
OURS = BODY.indices([SYNONYMS.get(name, name) for name in THEIR_NAMES])
OTHER_SIDE = [THEIR_NAMES.index(mirror_name(name)) for name in THEIR_NAMES]
MOST_ERROR_PX = 15.0
LEAST_PX, MOST_PX = 0.5, 40.0
SCORE_BINS = [(0.0, 0.1), (0.1, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.97), (0.97, 1.01)]


@dataclass(frozen=True, eq=False)
class Samples:
    """M crops, n keypoints: errors (M, n, 2) in crop px, features (M, n), score and visibility (M, n)."""

    error_px: np.ndarray
    values: dict[str, np.ndarray]
    score: np.ndarray
    visible: np.ndarray


def collect(folder: Path, network: BlazePoseNetwork, side_px: int) -> Samples:
    """Network outputs and errors for every rendered person, with the regions of normal use."""
    truth = read_truth(folder / "truth" / "truth.npz")
    rng = np.random.default_rng(int(folder.name.removeprefix("scene")))
    looks, errors, visible = [], [], []
    for view in truth.views:
        paths = sorted((folder / "videos" / view.camera).glob("*.jpg"))
        for path, xy, seen in zip(paths, view.xy_img[:, 0], view.visible[:, 0], strict=True):
            region = region_from_keypoints(xy, truth.skeleton)
            if region is None:
                continue
            move, grow, turn = rng.normal(0, 0.02, 2) * region.side_px, rng.normal(0, 0.05), rng.normal(0, 0.06)
            region = Region(
                centre_img=region.centre_img + move, side_px=region.side_px * np.exp(grow), angle_rad=region.angle_rad + turn
            )
            image = np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])
            look = landmarks_from_outputs(*network([square_crop(image, region, side_px)]), len(BODY), side_px)
            affine = crop_from_img(region, side_px)
            errors.append(look.xy_crop[0, OURS] - (xy @ affine[:, :2].T + affine[:, 2])[THEIRS])
            looks.append(look)
            visible.append(seen[THEIRS])
    known = [landmark_noise_features(look) for look in looks]
    values = {name: np.concatenate([one[name] for one in known])[:, OURS] for name in known[0]}
    score = np.concatenate([look.visibility * look.presence[:, None] for look in looks])[:, OURS]
    return Samples(np.array(errors), values, score, np.array(visible))


def stacked(samples: list[Samples]) -> Samples:
    values = {name: np.concatenate([one.values[name] for one in samples]) for name in samples[0].values}
    rest = (np.concatenate([getattr(one, name) for one in samples]) for name in ("error_px", "score", "visible"))
    error, score, visible = rest
    return Samples(error, values, score, visible)


def fit_weights(data: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n,) and weights (F,) of greatest Gaussian likelihood; errors count as at most MOST_ERROR_PX."""
    design = np.stack([data.values[name] for name in data.values], axis=-1)
    return fit_log_sigma(np.minimum((data.error_px**2).mean(-1), MOST_ERROR_PX**2), design, OTHER_SIDE)


def sigma_of(data: Samples, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    log_sigma = offset + np.stack([data.values[name] for name in data.values], axis=-1) @ weight
    return np.exp(np.clip(log_sigma, np.log(LEAST_PX), np.log(MOST_PX)))


def print_calibration(data: Samples, sigma: np.ndarray) -> None:
    """Mean of (error / sigma)^2 per axis by score; 1 is right."""
    ratio = np.minimum((data.error_px**2).mean(-1), MOST_ERROR_PX**2) / sigma**2
    print("score          n    rms px  sigma px  (e/sigma)^2  median-based")
    for low, high in SCORE_BINS:
        inside = (data.score >= low) & (data.score < high)
        if inside.any():
            error = data.error_px[inside]
            # the median of chi2_2 / 2 is ln 2
            typical = np.median(ratio[inside]) / np.log(2)
            print(
                f"{low:.2f}-{min(high, 1):.2f} {inside.sum():8d} {np.sqrt((error**2).mean()):8.2f} "
                f"{np.median(sigma[inside]):8.2f} {ratio[inside].mean():11.2f} {typical:11.2f}"
            )
    for k, name in enumerate(THEIR_NAMES):
        seen = data.visible[:, k]
        print(
            f"{name:16s} (e/sigma)^2 {ratio[:, k].mean():5.2f}   visible {ratio[seen, k].mean():5.2f}   "
            f"hidden {ratio[~seen, k].mean() if (~seen).any() else np.nan:5.2f}   "
            f"mean error x, y px {data.error_px[:, k].mean(0).round(1)}"
        )


def write_model(path: Path, data: Samples, offset: np.ndarray, weight: np.ndarray, scenes: int) -> None:
    known = dict(zip([BODY.keypoints[k] for k in OURS], offset, strict=True))
    lines = [
        f'made_by = "bench/fit_blazepose_noise.py: {scenes} rendered scenes, {len(data.score)} crops, '
        f'errors against mesh keypoints counted up to {MOST_ERROR_PX:g} crop px"',
        f"least_px = {LEAST_PX}",
        f"most_px = {MOST_PX}",
        "",
        "[weights]",
        *(f"{name} = {value:.4f}" for name, value in zip(data.values, weight, strict=True)),
        "",
        "# keypoints the mesh does not have take the value of their neighbour, fingers a fifth more than the wrist",
        "[offset]",
        *(f"{name} = {(known[name] if name in known else stand_in(name, known)):.4f}" for name in BODY.keypoints),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def stand_in(name: str, known: dict[str, float]) -> float:
    side = name.partition("_")[0]
    if "mouth" in name:
        return known["nose"]
    if "eye" in name:
        return known[f"{side}_eye"]
    return known[f"{side}_wrist"] + np.log(1.2)


def fit(out: Path, card_name: str) -> None:
    card = read_card(card_name)
    decoding = card.decoding
    file = fetch(card, default_cache_dir())
    network = BlazePoseNetwork(file, (decoding.landmarks, decoding.presence, decoding.heatmaps), card.input, "auto", 1)
    folders = [folder for folder in sorted(out.glob("scene*")) if is_rendered(folder)]
    samples = [collect(folder, network, card.input.side_px) for folder in folders]
    print(f"{len(folders)} scenes; each judged by a fit to the scenes of the other three quarters")
    kept, sigmas = [], []
    for part in range(4):
        others = stacked([one for i, one in enumerate(samples) if i % 4 != part])
        mine = stacked([one for i, one in enumerate(samples) if i % 4 == part])
        kept.append(mine)
        sigmas.append(sigma_of(mine, *fit_weights(others)))
    print_calibration(stacked(kept), np.concatenate(sigmas))
    everything = stacked(samples)
    offset, weight = fit_weights(everything)
    print(dict(zip(everything.values, weight.round(3).tolist(), strict=True)))
    write_model(card.folder / decoding.noise, everything, offset, weight, len(folders))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "fit"))
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenes", type=int, default=24)
    parser.add_argument("--card", default="blazepose_full", help="landmark network to fit")
    arguments = parser.parse_args()
    if arguments.step == "render":
        render_everyday(arguments.out, arguments.scenes, print)
    else:
        fit(arguments.out, arguments.card)


if __name__ == "__main__":
    main()

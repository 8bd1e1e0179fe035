"""The noise model of a user's network, from simulated people whose keypoints are known exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import minimize

from posefuse.core import Frame, Region, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import mirror_name
from posefuse.detection import region_from_keypoints
from posefuse.detection.networks import OneStageDetector, TopDownDetector
from posefuse.detection.noise import FEATURES, NoiseModel, keypoint_noise_features
from posefuse.formats.truth import read_truth

# errors count up to this share of the crop's height: what is further off is a confusion
MOST_ERROR = 0.06
# regions come from poses that are not exact: standard deviation of their place and size, shares of the side, and of their angle
_MOVED, _GROWN, _TURNED_RAD = 0.02, 0.05, 0.06
_SYNONYMS = {"left_foot_index": "left_big_toe", "right_foot_index": "right_big_toe"}


@dataclass(frozen=True, eq=False)
class NoiseSamples:
    """M looks at people, n keypoints that the truth has, along x and y: shares of the crop's height.

    Attributes:
        names: of the n keypoints, as the network calls them.
        error: (M, n, 2); NaN where the network gives nothing. values: feature -> (M, n, 2).
    """

    names: tuple[str, ...]
    error: Array
    values: dict[str, Array]


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """A fitted model, and its fit on held-out people.

    Attributes:
        noise: the model. samples: looks that it was fitted to.
        ratio: mean of (error / sigma)^2 per axis, each quarter of the scenes judged by a fit to the others; 1 is right.
        ratio_of: the same by keypoint.
    """

    noise: NoiseModel
    samples: int
    ratio: float
    ratio_of: dict[str, float]


def collect(folder: Path, detector: TopDownDetector | OneStageDetector, seed: int) -> NoiseSamples:
    """Network outputs and errors for every person of a rendered scene, with the regions of normal use."""
    truth = read_truth(folder / "truth" / "truth.npz")
    names, theirs, ours = shared_keypoints(detector.skeleton, truth.skeleton)
    rng = np.random.default_rng(seed)
    errors: list[Array] = []
    values: dict[str, list[Array]] = {name: [] for name in FEATURES}
    for view in truth.views:
        paths = sorted((folder / "videos" / view.camera).glob("*.*g"))
        for i, (path, people) in enumerate(zip(paths, view.xy_img, strict=True)):
            region = region_from_keypoints(people[0], truth.skeleton)
            image = cv2.imread(str(path))
            if region is None or image is None:
                continue
            frame = Frame(
                camera=view.camera, seq=i, t_ns=int(view.t_ns[i]), received_ns=0, image=np.ascontiguousarray(image[..., ::-1])
            )
            seen = detector.observed(frame, _as_in_use(region, rng))
            if seen is None:
                continue
            exact = people[0] @ seen.input_from_img[:, :2].T + seen.input_from_img[:, 2]
            errors.append((seen.keypoints.xy[0, ours] - exact[theirs]) / seen.height_px)
            found = keypoint_noise_features(seen.keypoints, seen.height_px)
            for name in FEATURES:
                values[name].append(found[name][0, ours])
    shape = (len(errors), len(names), 2)
    return NoiseSamples(
        names, np.array(errors).reshape(shape), {name: np.array(rows).reshape(shape) for name, rows in values.items()}
    )


def fit_noise(scenes: Sequence[NoiseSamples], made_by: str, parts: int = 4) -> NoiseFit:
    """The model of greatest likelihood of all scenes, judged by fits that leave each `parts`-th of them out."""
    names = scenes[0].names
    ratios = []
    for part in range(parts):
        others = [one for i, one in enumerate(scenes) if i % parts != part]
        mine = [one for i, one in enumerate(scenes) if i % parts == part]
        if others and mine:
            ratios.append(_ratio(_stacked(mine), _model(_stacked(others), made_by)))
    everything = _stacked(scenes)
    judged = np.concatenate(ratios) if ratios else _ratio(everything, _model(everything, made_by))
    by_keypoint = np.nanmean(judged, axis=(0, 2))
    return NoiseFit(
        _model(everything, made_by),
        len(everything.error),
        float(np.nanmean(judged)),
        dict(zip(names, by_keypoint.tolist(), strict=True)),
    )


def noise_text(noise: NoiseModel) -> str:
    """The model as TOML, as `read_noise` reads it."""
    lines = [f'made_by = "{noise.made_by}"', f"least = {noise.least}", f"most = {noise.most}", "", "[weights]"]
    lines += [f"{name} = {value:.4f}" for name, value in noise.weights.items()]
    lines += ["", '# keypoints that the simulated people do not have take the value of ""', "[offset]"]
    lines += [f'"{name}" = {value:.4f}' for name, value in noise.offset.items()]
    return "\n".join(lines) + "\n"


def shared_keypoints(skeleton: Skeleton, truth: Skeleton) -> tuple[tuple[str, ...], Array, Array]:
    """Names of keypoints that both have, and their places in the truth and in the network's set."""
    by_true_name = {_SYNONYMS.get(name, name): name for name in skeleton.keypoints}
    shared = [name for name in truth.keypoints if name in by_true_name]
    names = tuple(by_true_name[name] for name in shared)
    return names, truth.indices(shared), skeleton.indices(names)


def _as_in_use(region: Region, rng: np.random.Generator) -> Region:
    move, grow, turn = rng.normal(0, _MOVED, 2) * region.side_px, rng.normal(0, _GROWN), rng.normal(0, _TURNED_RAD)
    return Region(centre_img=region.centre_img + move, side_px=region.side_px * np.exp(grow), angle_rad=region.angle_rad + turn)


def _stacked(scenes: Sequence[NoiseSamples]) -> NoiseSamples:
    values = {name: np.concatenate([one.values[name] for one in scenes]) for name in FEATURES}
    return NoiseSamples(scenes[0].names, np.concatenate([one.error for one in scenes]), values)


def _model(data: NoiseSamples, made_by: str) -> NoiseModel:
    # both axes are samples of one law; detections without a keypoint take its average
    square = np.minimum(data.error**2, MOST_ERROR**2)
    square = np.where(np.isfinite(square), square, np.nanmean(square, axis=(0, 2), keepdims=True))
    flat = np.moveaxis(square, 2, 1).reshape(-1, len(data.names))
    design = np.stack([np.moveaxis(data.values[name], 2, 1).reshape(flat.shape) for name in FEATURES], axis=-1)
    other_side = [data.names.index(mirror_name(name)) for name in data.names]
    offset, weight = fit_log_sigma(flat, design, other_side)
    offsets = dict(zip(data.names, offset.tolist(), strict=True)) | {"": float(offset.mean())}
    return NoiseModel(made_by=made_by, weights=dict(zip(FEATURES, weight.tolist(), strict=True)), offset=offsets)


def _ratio(data: NoiseSamples, noise: NoiseModel) -> Array:
    """(M, n, 2) of (error / sigma)^2, errors counted up to `MOST_ERROR`."""
    return np.asarray(np.minimum(data.error**2, MOST_ERROR**2) / noise.sigma(data.values, data.names) ** 2)


def fit_log_sigma(square: Array, design: Array, other_side: Sequence[int]) -> tuple[Array, Array]:
    """Offsets (n,) and weights (F,) of log sigma = offset + design . weights, for Gaussian errors of that sigma.

    Args:
        square: (M, n) squared errors per coordinate, in whatever unit sigma is to have, outliers limited.
        design: (M, n, F) features.
        other_side: (n,) place of each keypoint's mirror image: people are as good as those.
    """
    count = square.shape[1]

    def loss(parameters: Array) -> tuple[float, Array]:
        offset, weight = parameters[:count], parameters[count:]
        log_sigma = offset + design @ weight
        ratio = square * np.exp(-2 * log_sigma)
        slope = 1 - ratio
        gradient = np.concatenate([slope.mean(0), np.einsum("mk,mkf->f", slope, design) / len(square)])
        return float((log_sigma + ratio / 2).mean(0).sum()), gradient

    typical = 0.5 * np.log(np.maximum(square.mean(), 1e-12))
    start = np.concatenate([np.full(count, typical), np.zeros(design.shape[-1])])
    solved = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000})
    offset = solved.x[:count]
    return (offset + offset[list(other_side)]) / 2, solved.x[count:]

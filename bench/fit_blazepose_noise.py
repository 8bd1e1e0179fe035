"""Fit the noise model of the BlazePose landmark network on rendered people, whose keypoints are known exactly.

    python bench/fit_blazepose_noise.py OUT [--scenes 24] [--card NAME]

draws the scenes into OUT (minutes; may be interrupted and resumed), fits, prints the calibration and writes the model file.
Bodies, motions and cameras are drawn for this purpose alone; none of them appears in a reported measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from harness import Use, answer, arguments, checked, truth_of

from posefuse.core import SKELETONS
from posefuse.core.skeleton import mirror_name
from posefuse.detection import fetch_all, region_from_keypoints
from posefuse.detection.card import LandmarkCard, read_card
from posefuse.detection.crops import crop_from_img, square_crop
from posefuse.detection.decode import landmarks_from_outputs
from posefuse.detection.engines import BlazePoseNetwork
from posefuse.detection.noise import NoiseModel, landmark_noise_features
from posefuse.foundation.platform import default_cache_dir
from posefuse_sim.fitting import _as_in_use as as_in_use
from posefuse_sim.fitting import fit_log_sigma, noise_text, render_everyday, shared_keypoints
from posefuse_sim.scene import read_scene
from posefuse_sim.session import SessionPaths

BODY, TRUE_BODY = SKELETONS["blazepose33"], SKELETONS["anatomical23"]
NAMES, THEIRS, OURS = shared_keypoints(BODY, TRUE_BODY)
MOST_ERROR_PX = 15.0
LEAST_PX, MOST_PX = 0.5, 40.0
PARTS = 4


@dataclass(frozen=True, eq=False)
class Samples:
    """M crops, n keypoints: errors (M, n, 2) in crop px, features (M, n, F)."""

    error_px: np.ndarray
    values: np.ndarray

    @staticmethod
    def stacked(samples: Sequence[Samples]) -> Samples:
        return Samples(*(np.concatenate([getattr(one, part.name) for one in samples]) for part in fields(Samples)))

    @property
    def square(self) -> np.ndarray:
        """(M, n) per axis; errors count as at most MOST_ERROR_PX."""
        return np.minimum((self.error_px**2).mean(-1), MOST_ERROR_PX**2)


def collect(folder: Path, network: BlazePoseNetwork, side_px: int) -> tuple[Samples, list[str]]:
    """Network outputs and errors for every rendered person, with the regions of normal use; and the features' names."""
    truth = truth_of(folder)
    rng = np.random.default_rng(int(folder.name.removeprefix("scene")))
    looks, errors = [], []
    for view in truth.views:
        paths = sorted((folder / "videos" / view.camera).glob("*.jpg"))
        for path, xy in zip(paths, view.xy_img[:, 0], strict=True):
            region = region_from_keypoints(xy, truth.skeleton)
            if region is None:
                continue
            region = as_in_use(region, rng)
            image = np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])
            landmarks, presence, heatmaps = network([square_crop(image, region, side_px)])
            look = landmarks_from_outputs(landmarks, presence, heatmaps, len(BODY), side_px)
            affine = crop_from_img(region, side_px)
            errors.append(look.xy_crop[0, OURS] - (xy @ affine[:, :2].T + affine[:, 2])[THEIRS])
            looks.append(look)
    known = [landmark_noise_features(look) for look in looks]
    values = np.stack([np.concatenate([one[name] for one in known])[:, OURS] for name in known[0]], axis=-1)
    return Samples(np.array(errors), values), list(known[0])


def fit_weights(data: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n,) and weights (F,) of greatest Gaussian likelihood."""
    return fit_log_sigma(data.square, data.values, [NAMES.index(mirror_name(name)) for name in NAMES])


def ratio(data: Samples, offset: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """(M, n) (error / sigma)^2 per axis by a fit; 1 is right in the mean."""
    sigma = np.exp(np.clip(offset + data.values @ weight, np.log(LEAST_PX), np.log(MOST_PX)))
    return data.square / sigma**2


def model_of(data: Samples, features: Sequence[str], scenes: int) -> NoiseModel:
    """Keypoints the mesh does not have take the value of their neighbour, fingers a fifth more than the wrist."""
    offset, weight = fit_weights(data)
    known = dict(zip(NAMES, map(float, offset), strict=True))
    made_by = (
        f"bench/fit_blazepose_noise.py: {scenes} rendered scenes, {len(data.error_px)} crops, "
        f"errors against mesh keypoints counted up to {MOST_ERROR_PX:g} crop px"
    )
    return NoiseModel(
        made_by=made_by,
        weights=dict(zip(features, map(float, weight), strict=True)),
        offset={name: known[name] if name in known else stand_in(name, known) for name in BODY.keypoints},
        least=LEAST_PX,
        most=MOST_PX,
    )


def stand_in(name: str, known: dict[str, float]) -> float:
    side = name.partition("_")[0]
    if "mouth" in name:
        return known["nose"]
    if "eye" in name:
        return known[f"{side}_eye"]
    return known[f"{side}_wrist"] + float(np.log(1.2))


def main() -> None:
    args = arguments(__doc__, positional=("out",), out=Path, scenes=24, card="blazepose_full")
    folders = render_everyday(args.out, args.scenes, print)
    for folder in folders:
        checked(read_scene(SessionPaths(folder).scene), Use.FIT)
    card = read_card(args.card, LandmarkCard)
    decoding, file = card.decoding, fetch_all([card], default_cache_dir())[0]
    network = BlazePoseNetwork(file, (decoding.landmarks, decoding.presence, decoding.heatmaps), card.input, "auto", 1)
    samples = []
    for folder in folders:
        sample, features = collect(folder, network, card.input.size_wh[0])
        samples.append(sample)
    judged = []
    for part in range(PARTS):
        others = Samples.stacked([one for i, one in enumerate(samples) if i % PARTS != part])
        judged.append(ratio(Samples.stacked(samples[part::PARTS]), *fit_weights(others)).ravel())
    model = model_of(Samples.stacked(samples), features, len(folders))
    card.noise_file.write_text(noise_text(model), encoding="utf-8")
    mean = {"keypoints": sum(map(len, judged)), "(e/sigma)^2": float(np.concatenate(judged).mean())}
    answer(args, {"Each quarter of the scenes, judged by a fit to the others; 1 is right": [mean]})


if __name__ == "__main__":
    main()

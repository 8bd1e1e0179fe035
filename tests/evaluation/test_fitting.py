"""Fits to people known exactly: laws are recovered, sets get what they can tell, and the command writes what it fitted."""

from pathlib import Path

import built
import numpy as np
import pytest
from commands import figures

from posefuse.core import SKELETONS, Rig
from posefuse.detection.card import read_card
from posefuse.detection.noise import FEATURES, read_noise
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.formats.rig import write_rig
from posefuse_sim.files import write_truth
from posefuse_sim.fitting import NoiseSamples, directions_of, fit_log_sigma, fit_noise, noise_text

NAMES = ("nose", "left_knee", "right_knee")
TRUE_WEIGHT = {"doubt": 0.7, "spread": 0.4, "rival": 0.9}


def drawn(seed: int, count: int) -> NoiseSamples:
    """Errors of a known law."""
    rng = np.random.default_rng(seed)
    values = {name: np.abs(rng.normal(0, 0.6, (count, len(NAMES), 2))) for name in FEATURES}
    offset = np.log([0.006, 0.01, 0.01])[:, None]
    sigma = np.exp(offset + sum(TRUE_WEIGHT[name] * values[name] for name in FEATURES))
    return NoiseSamples(NAMES, rng.normal(0, 1, sigma.shape) * sigma, values)


def test_log_sigma_of_a_known_law_is_recovered():
    data = drawn(0, 8000)
    design = np.stack([data.values[name][..., 0] for name in FEATURES], axis=-1)
    offset, weight = fit_log_sigma(data.error[..., 0] ** 2, design, [0, 2, 1])
    assert weight == pytest.approx(list(TRUE_WEIGHT.values()), abs=0.06)
    assert offset == pytest.approx(np.log([0.006, 0.01, 0.01]), abs=0.05)
    assert offset[1] == offset[2], "people are as good as their mirror images"


def test_a_noise_model_is_right_about_scenes_it_was_not_fitted_to(tmp_path):
    fit = fit_noise([drawn(seed, 600) for seed in range(8)], "a test")
    assert fit.ratio == pytest.approx(1.0, abs=0.12) and fit.samples == 8 * 600
    path = tmp_path / "x.noise.toml"
    path.write_text(noise_text(fit.noise))
    again = read_noise(path)
    assert again.weights == pytest.approx(fit.noise.weights, abs=1e-4)
    assert again.offset == pytest.approx(fit.noise.offset, abs=1e-4)


def test_a_keypoint_that_is_missing_now_and_then_is_fitted_from_the_others():
    scenes = [drawn(seed, 400) for seed in range(4)]
    for scene in scenes:
        scene.error[::3, 0] = np.nan
    fit = fit_noise(scenes, "a test")
    assert all(np.isfinite(list(fit.noise.offset.values()))) and np.isfinite(fit.ratio)


def test_sets_without_hands_and_feet_are_fitted_along_directions_they_determine():
    coco, whole = directions_of(SKELETONS["coco17"]), directions_of(SKELETONS["coco_wholebody_133"])
    assert coco["wrist"] == ("forearm",) and coco["ankle"] == ("shank", "outward")
    assert whole["wrist"] == ("forearm", "hand", "palm") and "foot" in whole["ankle"]
    assert coco["knee"] == whole["knee"]


discs = pytest.importorskip("discs", reason="the package onnx is not installed")


def scene(folder: Path, rig: Rig, turned_rad: float) -> None:
    """A finished scene: discs where a detector marks people who hold their wrists 40 mm further out, and the truth."""
    xyz = discs.true_xyz(turned_rad)
    discs.draw(rig, xyz, folder / "videos")
    truth_set = SKELETONS["anatomical23"]
    exact = np.full((len(xyz), 1, len(truth_set), 3), np.nan)
    exact[:, 0, : len(discs.SKELETON)] = xyz
    for side in ("left", "right"):
        elbow, wrist = (truth_set.index(f"{side}_{joint}") for joint in ("elbow", "wrist"))
        along = exact[:, 0, wrist] - exact[:, 0, elbow]
        exact[:, 0, wrist] += 0.04 * along / np.linalg.norm(along, axis=-1, keepdims=True)
    exact[:, 0, len(discs.SKELETON) :] = xyz[:, -1:]
    t_ns = np.round(np.arange(len(xyz)) / discs.RATE_HZ * 1e9).astype(np.int64)
    (folder / "truth").mkdir(parents=True)
    write_truth(folder / "truth" / "truth.npz", built.truth(rig, exact, t_ns, truth_set))
    write_rig(folder / "rig.toml", rig)


def test_the_command_fits_a_card_on_scenes_that_are_there(ring_rig, tmp_path, capsys) -> None:
    rig = ring_rig(4, size_wh=(720, 560))
    for place, turned_rad in (("everyday", 0.0), ("moving", 1.0)):
        scene(tmp_path / "scenes" / place / "scene00", rig, turned_rad)
    card = discs.card_of("simcc", tmp_path)
    options = ["--scenes-in", tmp_path / "scenes", "--scenes", "1", "--moving", "1"]
    assert figures(capsys, "fit-noise", card, *options)["crops"] == 4 * discs.FRAMES
    noise = read_noise(tmp_path / "simcc.noise.toml")
    assert noise.offset["left_wrist"] > noise.offset["left_shoulder"] + 1, "marks that are off make a keypoint less sure"
    table = read_joint_centres(tmp_path / "simcc.joint_centres.toml")
    assert table.offsets["wrist"]["forearm"] == pytest.approx(0.04, abs=0.003)
    assert abs(table.offsets["elbow"]["upper_arm"]) < 0.003
    text = card.read_text().replace("[input]", 'noise = "simcc.noise.toml"\njoint_centres = "simcc.joint_centres.toml"\n[input]')
    card.write_text(text)
    assert read_card(card).noise_file == tmp_path / "simcc.noise.toml"

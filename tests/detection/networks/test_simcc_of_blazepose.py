"""A network that really sees people, in the SimCC layout: BlazePose's heatmaps as distributions along x and y."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posefuse.core import pick_keypoints
from posefuse.detection import BlazePoseConfig, read_card
from posefuse.detection.card import LandmarkCard, NetworkInput, OnnxCard, PersonCard
from posefuse.detection.engines import BlazePoseNetwork
from posefuse.detection.networks import TopDownDetector
from posefuse.detection.search import SquareFinder
from posefuse.evaluation import true_xyz_at
from posefuse.formats import read_truth
from posefuse.pipeline import TrackConfig, find_session, track_session
from posefuse_sim.fitting import collect, fit_noise, noise_text, render_everyday

SIDE, CELLS, BINS = 256, 64, 512


class BlazePoseAsSimcc:
    """Stands for an `OnnxNetwork` of layout simcc."""

    def __init__(self) -> None:
        landmarks = read_card("blazepose_full", LandmarkCard)
        file = BlazePoseConfig().fetch()[1]
        self._network = BlazePoseNetwork(
            file, (landmarks.decoding.heatmaps, landmarks.decoding.presence), landmarks.input, "f32", 1
        )
        self.card = OnnxCard(
            name="simcc", folder=Path(), kind="simcc", file="none", sha256="0" * 64, licence="Apache-2.0",
            keypoints="blazepose33", input=NetworkInput(size_wh=(SIDE, SIDE)), least_keypoint_score=0.2,
        )  # fmt: skip

    def __call__(self, crops: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        heatmaps, presence = self._network(crops)
        value = 1 / (1 + np.exp(-heatmaps[..., :33].astype(np.float64)))
        value *= presence.reshape(-1, 1, 1, 1) > 0.5
        # BlazePose draws a keypoint at px 4 i - 0.5 into cell i, and a bin is half a px
        at = (np.arange(BINS) / 2 + 0.5) / (SIDE / CELLS)
        along = [np.moveaxis(value.max(axis), 1, -1) for axis in (1, 2)]
        simcc = [np.array([[np.interp(at, np.arange(CELLS), line) for line in one] for one in both]) for both in along]
        return [[simcc[0][i : i + 1], simcc[1][i : i + 1]] for i in range(len(crops))]


def silent(*_: object) -> None: ...


def simcc_detector(**changes: object) -> TopDownDetector:
    network = BlazePoseAsSimcc()
    network.card = replace(network.card, **changes)
    finder = SquareFinder(read_card("blazepose_persons", PersonCard), BlazePoseConfig().fetch()[0], "f32", 1)
    return TopDownDetector(network, finder, {})


@pytest.mark.slow
@pytest.mark.gl
def test_fitted_noise_is_right(models: None, demo_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted to rendered people, judged by people left out, and by the pose of another one."""
    detector = simcc_detector()
    scenes = [collect(folder, detector, seed=i) for i, folder in enumerate(render_everyday(tmp_path / "scenes", 4, silent))]
    fit = fit_noise(scenes, "a test")
    assert fit.ratio == pytest.approx(1.0, abs=0.3)
    (tmp_path / "noise.toml").write_text(noise_text(fit.noise))
    centres = str(read_card("blazepose_full").joint_centres_file)
    fitted = {"folder": tmp_path, "noise": "noise.toml", "joint_centres": centres}
    monkeypatch.setattr("posefuse.detection.build.build_detector", lambda choice, rig: simcc_detector(**fitted))
    poses = track_session(find_session(demo_session, config := TrackConfig(raw=True, end_s=2.5)), config).recording.poses
    truth = read_truth(demo_session / "truth" / "truth.npz")
    joints = [f"{s}_{joint}" for s in ("left", "right") for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]
    exact = pick_keypoints(true_xyz_at(truth, poses.t_ns)[:, 0], truth.skeleton, joints)
    off = pick_keypoints(poses.xyz_world[:, 0], poses.skeleton, joints) - exact
    precision = np.linalg.inv(poses.cov_world[:, 0, poses.skeleton.indices(joints)])
    nees = np.nanmean(np.einsum("tki,tkij,tkj->tk", off, precision, off))
    assert 1.5 < nees < 4.0

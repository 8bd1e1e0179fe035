"""A network that really sees people, in the SimCC layout: BlazePose's heatmaps as distributions along x and y."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from posefuse.core import SKELETONS, Recording
from posefuse.detection import BlazePoseConfig
from posefuse.detection.blazepose.network import Network
from posefuse.detection.blazepose.persons import PersonNetwork
from posefuse.detection.models import read_card
from posefuse.detection.networks.card import NetworkCard, NetworkInput
from posefuse.detection.networks.detector import TopDownDetector
from posefuse.detection.networks.people import SquareFinder
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session

SIDE, CELLS, BINS = 256, 64, 512


class BlazePoseAsSimcc:
    """Stands for an `OnnxNetwork` of layout simcc."""

    def __init__(self) -> None:
        landmarks = read_card("blazepose_full")
        file = BlazePoseConfig().fetch()[1]
        self._network = Network(file, (landmarks.decoding.heatmaps, landmarks.decoding.presence), landmarks.input, "f32", 1)
        self.card = NetworkCard(
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


@pytest.fixture(scope="module")
def recordings(models: None, demo_session: Path) -> tuple[Recording, Recording]:
    """The clip by the SimCC layout, and by BlazePose's own decoding; as marked, without joint centres."""

    def silent(*_: object) -> None: ...

    def run(config: TrackConfig) -> Recording:
        return track_session(find_session(demo_session, config), config, StageClock(), silent, silent, silent).recording

    config = TrackConfig(joint_centres=False, raw=True, end_s=0.8)
    own = run(config)
    patch = pytest.MonkeyPatch()
    persons = PersonNetwork.compiled(read_card("blazepose_persons"), BlazePoseConfig().fetch()[0], "f32", 1)
    network = BlazePoseAsSimcc()
    patch.setattr(
        "posefuse.detection.build.build_detector",
        lambda choice, rig: TopDownDetector(network, SquareFinder(persons, 0.5), 4, {}),  # type: ignore[arg-type]
    )
    try:
        return run(config), own
    finally:
        patch.undo()


def test_it_follows_the_person_as_well_as_the_network_does(recordings, demo_session):
    simcc, own = recordings
    truth = read_truth(demo_session / "truth" / "truth.npz")
    assert simcc.poses.skeleton == SKELETONS["blazepose33"]
    ours, theirs = (joint_errors(one.poses, truth) for one in (simcc, own))
    assert ours.found.min() > 0.97
    assert ours.mpjpe_mm < 1.25 * theirs.mpjpe_mm

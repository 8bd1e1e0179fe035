"""A live session's people keep their ids: lengths and clothes tell who came back."""

from collections.abc import Mapping

import built
import numpy as np

from posefuse.core import Detections2D, Kind, Pose3D
from posefuse.realtime.estimator import NamedTracker
from posefuse.realtime.group import search_slot
from posefuse.tracking.online import CameraStatistics, LiveSettings

PERIOD_NS = 33_333_333
RED, BLUE = np.tile([45.0, 60.0, 40.0], (3, 1)), np.tile([40.0, 10.0, -50.0], (3, 1))


class TrackerOfTwins:
    """Tracks of people of one size, as a test says; implements `Tracker`."""

    def __init__(self) -> None:
        self.here: dict[int, float] = {}
        self.last_seen: dict[int, Kind] = {}

    def add(self, detections: Detections2D) -> np.ndarray:
        return np.array(sorted(self.here))[: len(detections)]

    def at(self, t_ns: int) -> Pose3D:
        tracks = sorted(self.here)
        rng = np.random.default_rng(t_ns % 2**32)
        xyz = np.array([_body() + [self.here[track], 0, 0] for track in tracks]).reshape(-1, 17, 3)
        kind = np.array([np.full(17, self.last_seen.get(track, Kind.FUSED)) for track in tracks]).reshape(xyz.shape[:2])
        return built.pose(xyz + rng.normal(0, 0.01, xyz.shape), tracks, t_ns, cov=np.zeros((3, 3)), kind=kind)

    def looked_for(self, t_ns: int) -> Pose3D:
        return self.at(t_ns)

    def check(self) -> None:
        """Nothing can wait."""

    @property
    def health(self) -> Mapping[str, CameraStatistics]:
        return {}


def _body() -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform([-0.3, -0.2, 0.0], [0.3, 0.2, 1.7], (17, 3))


class Session:
    def __init__(self, settings: LiveSettings) -> None:
        self.tracks = TrackerOfTwins()
        self.named = NamedTracker(self.tracks, settings)
        self.i = 0

    def frames(self, count: int, clothes: Mapping[int, np.ndarray], cameras: int = 3) -> list[int]:
        """Ids of the last output, while the tracks wear this."""
        ids: list[int] = []
        for _ in range(count):
            self.i += 1
            for c in range(cameras):
                self.named.add(_view(c, self.i * PERIOD_NS, np.array([clothes[t] for t in sorted(self.tracks.here)])))
            ids = self.named.at(self.i * PERIOD_NS).person_id.tolist()
        return ids


def _view(c: int, t_ns: int, clothing: np.ndarray) -> Detections2D:
    return built.detections(f"c{c}", np.zeros((len(clothing), 17, 2)), t_ns, score=1.0, sigma_px=1.0, clothing_lab=clothing)


def _after_return(cameras: int) -> list[int]:
    """Two people of one size leave; they return at once, in the other order. Their ids in the order of the new tracks."""
    session = Session(LiveSettings(max_people=2))
    session.tracks.here = {0: 0.0, 1: 2.0}
    assert session.frames(30, {0: RED, 1: BLUE}, cameras) == [0, 1]
    session.tracks.here = {}
    assert session.frames(45, {}, cameras) == []
    session.tracks.here = {2: 0.0, 3: 2.0}
    session.frames(30, {2: BLUE, 3: RED}, cameras)
    identity = session.named._identity
    return [identity.person_of(2), identity.person_of(3)]


def test_twins_come_back_under_their_ids_by_their_clothes() -> None:
    assert _after_return(cameras=3) == [1, 0]


def test_colours_of_one_view_are_of_no_person() -> None:
    """Another person may stand before this one: nothing tells the twins apart, and the first ids are given in order."""
    assert _after_return(cameras=1) == [0, 1]


def test_who_is_out_of_sight_leaves_the_output_and_stays_expected() -> None:
    session = Session(LiveSettings(max_people=2, shown_s=0.3))
    session.tracks.here = {0: 0.0, 1: 2.0}
    assert session.frames(20, {0: RED, 1: BLUE}) == [0, 1]
    session.tracks.last_seen[1] = Kind.PREDICTED
    assert session.frames(3, {0: RED, 1: BLUE}) == [0, 1]
    assert session.frames(5, {0: RED, 1: BLUE}) == [0]
    assert session.named.looked_for(session.i * PERIOD_NS).person_id.tolist() == [0, 1]
    session.tracks.last_seen[1] = Kind.FUSED
    assert session.frames(1, {0: RED, 1: BLUE}) == [0, 1]


def test_tracks_that_ended_are_forgotten() -> None:
    session = Session(LiveSettings(max_people=2))
    for track in range(0, 40, 2):
        session.tracks.here = {track: 0.0, track + 1: 2.0}
        session.frames(2, {track: RED, track + 1: BLUE})
    assert len(session.named._measured_ns) == len(session.named._colours) == 2


def test_with_one_person_tracks_and_persons_are_the_same() -> None:
    session = Session(LiveSettings(max_people=1))
    session.tracks.here = {0: 0.0}
    session.tracks.last_seen[0] = Kind.PREDICTED
    assert session.frames(30, {0: RED}) == [0]


def test_cameras_that_look_when_they_can_search_together() -> None:
    """A new person is born from two views of one moment: each camera counting for itself would drift away from the others."""
    rng = np.random.default_rng(5)
    every_s, slowest_s = 0.5, 0.09
    together, by_itself = [], []
    for _ in range(4):
        looks_s = np.cumsum(rng.uniform(0.03, slowest_s, 600))
        slots = np.array([search_slot(round(at_s * 1e9), every_s) for at_s in looks_s])
        together.append(looks_s[np.flatnonzero(np.diff(slots, prepend=-1))][:40])
        own = [0.0]
        for at_s in looks_s:
            own += [at_s] if at_s - own[-1] > every_s else []
        by_itself.append(own[:40])
    assert np.ptp(together, axis=0).max() <= slowest_s
    assert np.ptp(by_itself, axis=0).max() > 3 * slowest_s

"""What goes out of a live session: only what is known well enough, people under their ids, joints at their centres."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import built
import numpy as np
import pytest
from no_outputs import KeptOutputs, StillPerson

from posefuse.core import SKELETONS, Detections2D, JointCentres, Kind, LiveJointCentres, Pose3D
from posefuse.core.poses import worst_sigma_m
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.realtime.config import KeypointGateSettings
from posefuse.realtime.estimator import Centring, Estimator, KeypointGate, NamedTracker, _known_to
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.group import search_slot
from posefuse.realtime.messages import Expected, SessionClock
from posefuse.tracking import at_joint_centres
from posefuse.tracking.body_directions import segment_lengths
from posefuse.tracking.online import CameraStatistics, LiveSettings

S = 1_000_000_000
COCO = SKELETONS["coco17"]


def pose(t_s: float, sigma_m: float = 0.02, kind: Kind = Kind.FUSED, people: tuple[int, ...] = (3, 8)) -> Pose3D:
    shape = (len(people), len(COCO))
    cov = np.eye(3) * sigma_m**2
    return built.pose(np.ones((*shape, 3)), people, round(t_s * S), cov=cov, kind=np.full(shape, kind))


def test_a_keypoint_too_unsure_is_missing_in_every_field() -> None:
    given = pose(1.0)
    cov = given.cov_world.copy()
    cov[0, 4, 2, 2] = 0.16**2
    cov[0, 5, 2, 2] = 0.14**2
    gate = KeypointGate(KeypointGateSettings())
    got = gate.passed(Pose3D(**{**vars(given), "cov_world": cov}))
    assert got.kind[0, 4] == Kind.MISSING and got.n_views[0, 4] == 0
    assert np.isnan(got.xyz_world[0, 4]).all() and np.isnan(got.cov_world[0, 4]).all() and np.isnan(got.reproj_px[0, 4])
    assert np.isfinite(got.xyz_world[0, 5]).all()
    assert gate.figures() == {"keypoints": pytest.approx(1 / 34), "people": 0.0}


def test_a_person_of_whom_nothing_is_left_is_not_there() -> None:
    given = pose(1.0)
    cov = given.cov_world.copy()
    cov[0] *= 100
    gate = KeypointGate(KeypointGateSettings(sigma_m=0.1))
    assert gate.passed(Pose3D(**{**vars(given), "cov_world": cov})).person_id.tolist() == [8]
    assert gate.people == (2, 1)
    assert gate.passed(pose(1.01)).person_id.tolist() == [3, 8]


def test_what_was_not_measured_for_long_is_withheld_however_sure() -> None:
    gate = KeypointGate(KeypointGateSettings(unmeasured_s=0.4))
    gate.passed(pose(1.0))
    for t_s, there in ((1.1, 2), (1.39, 2), (1.41, 0), (1.9, 0)):
        assert len(gate.passed(pose(t_s, kind=Kind.PREDICTED)).person_id) == there
    assert len(gate.passed(pose(2.0)).person_id) == 2
    # a new person is not judged by a person who left
    assert len(gate.passed(pose(2.5, kind=Kind.PREDICTED, people=(9,))).person_id) == 1


def test_the_axis_known_worst_decides_whichever_way_it_points() -> None:
    rng = np.random.default_rng(0)
    turns = np.linalg.qr(rng.normal(size=(200, 3, 3)))[0]
    sigmas = rng.uniform(0.05, 0.2, (200, 3))
    # right at the limit, and what is not known
    sigmas[:20, 0], sigmas[20:25], sigmas[25:30, 1] = 0.15, np.nan, np.inf
    cov = turns @ (sigmas[:, :, None] ** 2 * np.swapaxes(turns, 1, 2))
    worst = np.where(np.isnan(sigmas).any(axis=1), np.inf, sigmas.max(axis=1))
    np.testing.assert_allclose(worst_sigma_m(cov), worst)
    found = _known_to(cov.reshape(10, 20, 3, 3), 0.15)
    np.testing.assert_array_equal(found, (worst_sigma_m(cov) <= 0.15).reshape(10, 20))
    assert found.any() and not found.all()


# --- people keep their ids: lengths and clothes tell who came back


FRAME_NS = 33_333_333
TWIN = np.random.default_rng(3).uniform([-0.3, -0.2, 0.0], [0.3, 0.2, 1.7], (17, 3))
RED, BLUE = np.tile([45.0, 60.0, 40.0], (3, 1)), np.tile([40.0, 10.0, -50.0], (3, 1))


class TrackerOfTwins:
    """Tracks of people of one size, as a test says; like `Tracker`."""

    health: ClassVar[dict[str, CameraStatistics]] = {}

    def __init__(self) -> None:
        self.here: dict[int, float] = {}
        self.last_seen: dict[int, Kind] = {}

    def add(self, detections: Detections2D) -> np.ndarray:
        return np.array(sorted(self.here))[: len(detections)]

    def at(self, t_ns: int) -> Pose3D:
        tracks = sorted(self.here)
        rng = np.random.default_rng(t_ns % 2**32)
        xyz = np.array([TWIN + [self.here[track], 0, 0] for track in tracks]).reshape(-1, 17, 3)
        kind = np.array([np.full(17, self.last_seen.get(track, Kind.FUSED)) for track in tracks]).reshape(xyz.shape[:2])
        return built.pose(xyz + rng.normal(0, 0.01, xyz.shape), tracks, t_ns, cov=np.zeros((3, 3)), kind=kind)

    def check(self) -> None:
        """Nothing can wait."""


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
                self.named.add(_view(c, self.i * FRAME_NS, np.array([clothes[t] for t in sorted(self.tracks.here)])))
            ids = self.named.at(self.i * FRAME_NS).person_id.tolist()
        return ids


def _view(c: int, t_ns: int, clothing: np.ndarray) -> Detections2D:
    return built.detections(f"c{c}", np.zeros((len(clothing), 17, 2)), t_ns, score=1.0, sigma_px=1.0, clothing_lab=clothing)


def ids_of_twins(cameras: int, left: Sequence[np.ndarray], returned: Sequence[np.ndarray]) -> list[int]:
    """Two people of one size leave and return at once: the ids of those who return, by what each wears."""
    session = Session(LiveSettings(max_people=2))
    session.tracks.here = {0: 0.0, 1: 2.0}
    assert session.frames(30, dict(enumerate(left)), cameras) == [0, 1]
    session.tracks.here = {}
    assert session.frames(45, {}, cameras) == []
    session.tracks.here = {2: 0.0, 3: 2.0}
    session.frames(30, dict(enumerate(returned, 2)), cameras)
    identity = session.named._identity
    return [identity.person_of(2), identity.person_of(3)]


def test_twins_come_back_under_their_ids_by_their_clothes() -> None:
    assert ids_of_twins(3, (RED, BLUE), (RED, BLUE)) == [0, 1]
    assert ids_of_twins(3, (RED, BLUE), (BLUE, RED)) == [1, 0]


def test_clothes_in_one_view_do_not_distinguish_people() -> None:
    """The other twin may stand before this one in the only view: what each wears changes nothing."""
    assert ids_of_twins(1, (RED, BLUE), (BLUE, RED)) == ids_of_twins(1, (RED, BLUE), (RED, BLUE))


def test_who_is_out_of_sight_leaves_the_output_and_stays_expected() -> None:
    session = Session(LiveSettings(max_people=2, shown_s=0.3))
    session.tracks.here = {0: 0.0, 1: 2.0}
    assert session.frames(20, {0: RED, 1: BLUE}) == [0, 1]
    session.tracks.last_seen[1] = Kind.PREDICTED
    assert session.frames(3, {0: RED, 1: BLUE}) == [0, 1]
    assert session.frames(5, {0: RED, 1: BLUE}) == [0]
    assert session.named.looked_for(session.i * FRAME_NS).person_id.tolist() == [0, 1]
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
    together = []
    for _ in range(4):
        looks_s = np.cumsum(rng.uniform(0.03, slowest_s, 600))
        slots = np.array([search_slot(round(at_s * 1e9), every_s) for at_s in looks_s])
        together.append(looks_s[np.flatnonzero(np.diff(slots, prepend=-1))][:40])
    assert np.ptp(together, axis=0).max() <= slowest_s


# --- joint centres: what goes out has moved, the poses sent to the views have not, and a recording states by which table


K = len(BLAZEPOSE33)
FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
PERIOD_NS = 10_000_000
BEGIN_NS = 1_700_000_000_000_000_000


STANDING = built.standing(skeleton=BLAZEPOSE33)


def centres(cameras: Sequence[str], table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=BEGIN_NS, cameras=cameras, table=table)


def still_person() -> StillPerson:
    return StillPerson(STANDING, BLAZEPOSE33)


@pytest.mark.parametrize("wanted", [True, False])
def test_the_output_is_at_joint_centres_and_the_views_get_landmarks(ring_rig, wanted) -> None:
    rig, kept, tracker = ring_rig(3), KeptOutputs(), still_person()
    expected_by_cameras: list[Expected] = []
    fusion = Fusion(rig, Estimator(tracker, Centring(rig.names, wanted)), expected_by_cameras.append, SessionClock.begin(), kept)
    fusion.tick(BEGIN_NS, PERIOD_NS)
    fusion.take(centres(rig.names, FULL))
    fusion.tick(BEGIN_NS + 5 * PERIOD_NS, PERIOD_NS)
    before, after = kept.poses()
    expected = at_joint_centres(before, FULL, FULL.usual).xyz_world if wanted else before.xyz_world
    np.testing.assert_array_equal(before.xyz_world[0], STANDING)
    np.testing.assert_array_equal(after.xyz_world, expected)
    np.testing.assert_array_equal(expected_by_cameras[-1].xyz_world[0], STANDING)
    assert (np.abs(after.xyz_world - before.xyz_world).max() > 0.01) == wanted
    assert fusion.estimator.centring.made_by == (dict.fromkeys(rig.names, FULL.made_by) if wanted else {})
    # the table belongs to the views, wanted or not
    offered = [message for message in kept.offered if isinstance(message, LiveJointCentres)]
    assert [(message.cameras, message.table) for message in offered] == [(rig.names, FULL)]


def test_where_networks_differ_the_first_camera_with_a_table_counts() -> None:
    pose, other = still_person().at(0), JointCentres(made_by="another", offsets={"hip": {"up": 0.05}})
    centring = Centring("abc", wanted=True)
    centring.learn(centres(("c", "stranger"), FULL))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, FULL, FULL.usual).xyz_world)
    centring.learn(centres(("a",), None))
    centring.learn(centres(("b",), other))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, other, other.usual).xyz_world)
    assert centring.made_by == {"b": "another", "c": FULL.made_by}


def test_the_table_of_one_who_is_followed_for_long_counts_by_length() -> None:
    """The same table sent again does not make any person a stranger; another one does."""
    centring, tracker = Centring("ab", wanted=True), still_person()
    centring.learn(centres(("a",), FULL))
    shown = [centring.moved(tracker.at(i * PERIOD_NS)).xyz_world for i in range(3000)]
    usual = at_joint_centres(tracker.at(0), FULL, FULL.usual).xyz_world
    lengths = segment_lengths(np.broadcast_to(usual, (10, 1, K, 3)), BLAZEPOSE33)
    known = at_joint_centres(tracker.at(0), FULL, lengths).xyz_world
    np.testing.assert_array_equal(shown[0], usual)
    assert np.abs(known - usual).max() > 0.005
    assert np.abs(known - shown[-1]).max() < 0.0005
    assert np.abs(np.diff(shown, axis=0)).max() < 0.2 * np.abs(known - usual).max()
    centring.learn(centres(("b",), read_joint_centres(read_card("blazepose_full").joint_centres_file)))
    assert np.abs(centring.moved(tracker.at(3000 * PERIOD_NS)).xyz_world - shown[-1]).max() < 0.0001
    centring.learn(centres(("a",), replace(FULL, made_by="another")))
    np.testing.assert_array_equal(centring.moved(tracker.at(3001 * PERIOD_NS)).xyz_world, usual)

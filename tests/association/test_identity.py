"""Who a track is: by what does not change about a body, together, and only once there is evidence."""

import numpy as np
import pytest
from built import pose, standing
from scipy.stats import norm

from posefuse.association import CLOTHING_TRAITS, UNNAMED, Identity, identity, with_persons
from posefuse.association.memory import LastSeen
from posefuse.association.traits import Traits, body_lengths_m, plausible_share, sameness
from posefuse.core.skeleton import COCO17

PERIOD_NS = 33_333_333
NOISE_M = 0.012


def person_at(names: tuple[identity.Named, ...], track: int, t_ns: int) -> int:
    return int(identity.persons_at(names, np.array([track]), np.array([t_ns]))[0])


class Room:
    """People of given sizes at given places, measured with noise; keeps the identity state."""

    def __init__(self, scales: list[float], people_max: int, seed: int = 0) -> None:
        self.bodies = [standing(size=scale) for scale in scales]
        self.rng = np.random.default_rng(seed)
        self.state = Identity(people_max=people_max, lost_after_s=0.5)
        self.i = 0

    def frames(self, count: int, who: dict[int, tuple[int, float]]) -> None:
        """`who`: track -> (person, place along x)."""
        for _ in range(count):
            xyz = np.array([self.bodies[p] + [x, 0, 0] for p, x in who.values()]).reshape(-1, len(COCO17), 3)
            xyz = xyz + self.rng.normal(0, NOISE_M, xyz.shape)
            self.state = self.state.after(pose(xyz, list(who), self.i * PERIOD_NS), np.full((len(who), CLOTHING_TRAITS), np.nan))
            self.i += 1


def test_the_only_person_has_a_name_at_once_and_gets_it_back() -> None:
    room = Room([1.0], people_max=1)
    room.frames(1, {0: (0, 0.0)})
    assert room.state.person_of(0) == 0
    room.frames(20, {0: (0, 0.0)})
    room.frames(30, {})
    room.frames(1, {1: (0, 2.0)})
    assert room.state.person_of(1) == 0


@pytest.mark.parametrize("back", [(1, 2), (2, 1)])
def test_two_who_left_are_distinguished_when_they_return_elsewhere(back: tuple[int, int]) -> None:
    room = Room([1.0, 0.93, 1.06], people_max=3)
    room.frames(40, {0: (0, 0.0), 1: (1, 1.5), 2: (2, 3.0)})
    room.frames(30, {0: (0, 0.0)})
    room.frames(3, {0: (0, 0.0), 3: (back[0], 3.0), 4: (back[1], 1.5)})
    assert [room.state.person_of(track) for track in (3, 4)] == [UNNAMED, UNNAMED], "not decided before there is evidence"
    room.frames(20, {0: (0, 0.0), 3: (back[0], 3.0), 4: (back[1], 1.5)})
    assert [room.state.person_of(track) for track in (3, 4)] == list(back)
    begin_ns = 70 * PERIOD_NS
    assert person_at(room.state.names, 3, begin_ns) == back[0], "known from its first frame on, once it is known"


@pytest.mark.parametrize("people_max", [3, 4])
def test_two_who_differ_plainly_are_named_sooner_whether_or_not_a_stranger_may_come(people_max: int) -> None:
    room = Room([1.0, 0.8, 1.2], people_max)
    room.frames(40, {0: (0, 0.0), 1: (1, 1.5), 2: (2, 3.0)})
    room.frames(30, {0: (0, 0.0)})
    room.frames(5, {0: (0, 0.0), 3: (1, 3.0), 4: (2, 1.5)})
    assert [room.state.person_of(track) for track in (3, 4)] == [1, 2]


def test_who_may_be_either_of_two_alike_gets_one_of_their_names_after_more_frames() -> None:
    room = Room([1.0, 1.0], people_max=2)
    room.frames(40, {0: (0, 0.0), 1: (1, 1.5)})
    room.frames(30, {})
    room.frames(6, {2: (0, 3.0)})
    assert room.state.person_of(2) == UNNAMED
    room.frames(4, {2: (0, 3.0)})
    assert room.state.person_of(2) in (0, 1)


@pytest.mark.parametrize("swapped", [False, True])
def test_two_who_touched_are_distinguished_after_they_part(swapped: bool) -> None:
    room = Room([0.95, 1.05], people_max=2)
    room.frames(40, {0: (0, 0.0), 1: (1, 2.0)})
    room.frames(15, {0: (0, 0.9), 1: (1, 1.1)})
    parted_ns = room.i * PERIOD_NS
    after = {0: (1, 2.0), 1: (0, 0.0)} if swapped else {0: (0, 0.0), 1: (1, 2.0)}
    room.frames(40, after)
    expected = [1, 0] if swapped else [0, 1]
    assert [room.state.person_of(track) for track in (0, 1)] == expected
    assert [person_at(room.state.names, track, parted_ns) for track in (0, 1)] == expected
    before = [person_at(room.state.names, track, 30 * PERIOD_NS) for track in (0, 1)]
    assert before == [0, 1], "before they touched nothing changes"


def test_two_of_one_size_keep_their_names_as_nothing_speaks_against_it() -> None:
    room = Room([1.0, 1.0], people_max=2)
    room.frames(40, {0: (0, 0.0), 1: (1, 2.0)})
    room.frames(15, {0: (0, 0.9), 1: (1, 1.1)})
    room.frames(90, {0: (0, 0.0), 1: (1, 2.0)})
    assert [room.state.person_of(track) for track in (0, 1)] == [0, 1]
    assert len(room.state.names) == 2


def test_no_person_is_ever_two_tracks_of_one_frame() -> None:
    room = Room([1.0, 0.95, 1.05], people_max=2)
    room.frames(20, {0: (0, 0.0)})
    room.frames(20, {0: (0, 0.0), 1: (1, 2.0), 2: (2, 4.0)})
    room.frames(40, {1: (1, 2.0), 2: (2, 4.0)})
    for i in range(room.i):
        persons = [person_at(room.state.names, track, i * PERIOD_NS) for track in (1, 2)]
        persons += [person_at(room.state.names, 0, i * PERIOD_NS)] if i < 40 else []
        known = [person for person in persons if person != UNNAMED]
        assert len(set(known)) == len(known)


def test_a_frame_earlier_states_stay_as_they_were() -> None:
    room = Room([1.0, 0.9], people_max=2)
    room.frames(3, {0: (0, 0.0)})
    before = room.state
    room.frames(5, {0: (0, 0.0), 1: (1, 2.0)})
    assert list(before.tracks) == [0] and before.tracks[0].traits.frames.max() == 3


def test_running_variance_is_that_of_all_frames_and_pooling_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0.4, 0.02, (50, 7))
    one, two = Traits.unknown(7), Traits.unknown(7)
    for row in values[:20]:
        one = one.with_frame(row)
    for row in values[20:]:
        two = two.with_frame(row)
    both = one.pooled(two)
    np.testing.assert_allclose(both.mean, values.mean(axis=0))
    np.testing.assert_allclose(both.squares, 50 * values.var(axis=0), atol=1e-12)


def test_sameness_grows_with_evidence_and_is_symmetric() -> None:
    rng = np.random.default_rng(2)

    def learnt(scale: float, frames: int) -> Traits:
        traits, worn = Traits.unknown(7 + CLOTHING_TRAITS), np.full(CLOTHING_TRAITS, np.nan)
        for _ in range(frames):
            (lengths,) = body_lengths_m(standing(size=scale)[None] + rng.normal(0, NOISE_M, (1, 17, 3)), COCO17)
            traits = traits.with_frame(np.concatenate([lengths, worn]))
        return traits

    known, same, other = learnt(1.0, 60), learnt(1.0, 60), learnt(0.9, 60)
    assert sameness(known, same) > 0 > sameness(known, other)
    assert sameness(known, other) == pytest.approx(sameness(other, known))
    assert sameness(known, learnt(1.0, 2)) == 0, "two frames say nothing"


def test_a_trait_counts_by_its_difference_in_errors_and_in_people() -> None:
    """The ratio of two normal densities, written out: of errors that last, and of these and two of the population."""
    lengths_m, clothing = np.linspace(0.2, 0.5, 7), np.tile([50.0, 20.0, -30.0], 3)
    mean = np.concatenate([lengths_m, clothing])
    errors = np.concatenate([np.full(7, 0.01), np.tile([7.0, 4.0, 4.0], 3)])
    people = np.concatenate([0.08 * lengths_m, np.tile([22.0, 12.0, 16.0], 3)])

    def certain(values: np.ndarray) -> Traits:
        return Traits(frames=np.full(16, 100.0), mean=values, squares=np.zeros(16))

    for share in (0.0, 1.0, 2.0):
        # in standard deviations of the population
        half = share * people / 2
        same, two = np.sqrt(2) * errors, np.sqrt(2) * np.hypot(errors, people)
        densities = norm.logpdf(2 * half, 0, same) - norm.logpdf(2 * half, 0, two)
        cues = [densities[cue].sum() for cue in (slice(7), slice(7, 10), slice(10, 13), slice(13, 16))]
        expected = sum(np.log(0.97 * np.exp(cue) + 0.03) for cue in cues)
        assert sameness(certain(mean - half), certain(mean + half)) == pytest.approx(expected), share


def test_a_body_that_no_person_can_have_is_not_plausible() -> None:
    usual, giant, doll, child = body_lengths_m(np.stack([standing(size=size) for size in (1.0, 2.2, 0.3, 0.65)]), COCO17)
    assert plausible_share(usual) == 1 and plausible_share(child) > 0.9
    assert plausible_share(giant) < 0.5 and plausible_share(doll) < 0.5 and plausible_share(usual * np.nan) == 0
    # every length has limits of its own
    for i in range(len(usual)):
        for factor in (0.2, 5.0):
            odd = usual.copy()
            odd[i] *= factor
            assert plausible_share(odd) == pytest.approx(6 / 7), (i, factor)


def test_poses_under_other_ids_stand_in_their_order() -> None:
    renamed = with_persons(pose(np.arange(3.0)[:, None, None] + np.zeros((3, 17, 3)), [4, 5, 6]), [2, UNNAMED, 0])
    assert renamed.person_id.tolist() == [0, 2]
    assert renamed.xyz_world[:, 0, 0].tolist() == [2, 0]


def test_a_trait_that_is_not_seen_for_a_frame_keeps_its_mean() -> None:
    values = np.array([0.3, 0.5])
    traits = Traits.unknown(2).with_frame(values).with_frame(np.array([np.nan, 0.7]))
    np.testing.assert_allclose(traits.mean, [0.3, 0.6])
    np.testing.assert_array_equal(traits.frames, [1, 2])
    np.testing.assert_allclose(traits.squares, [0, 0.02], atol=1e-15)


def test_the_newest_decision_counts_for_every_track_and_time() -> None:
    rng = np.random.default_rng(0)
    rows = zip(*rng.integers(0, (6, 3, 50), (40, 3)).T.tolist(), strict=True)
    names = tuple(identity.Named(track=track, person=person, since_ns=since_ns) for track, person, since_ns in rows)
    tracks, t_ns = rng.integers(-1, 8, 300), rng.integers(0, 60, 300)
    for track, at_ns, got in zip(tracks.tolist(), t_ns.tolist(), identity.persons_at(names, tracks, t_ns).tolist(), strict=True):
        decided = [one.person for one in names if one.track == track and one.since_ns <= at_ns]
        assert got == (decided[-1] if decided else UNNAMED)


# --- where a person is expected, by the last measurements


BODY_M_S = np.array([1.0, 0.0, 0.0])
WRIST_M_S = np.array([3.0, -2.0, 0.5])


@pytest.mark.parametrize(("age_s", "by_its_own_speed"), [(0.04, True), (0.1, True), (0.3, False)])
def test_a_keypoint_is_expected_by_its_own_speed_in_the_next_frame_and_later_with_the_body(
    age_s: float, by_its_own_speed: bool
) -> None:
    xyz = np.array([[0.0, 0.0, 1.0], [0.2, 0.3, 1.4]])
    last = LastSeen(person_id=0, t_ns=0, xyz_world=xyz, velocity_m_s=np.stack([BODY_M_S, WRIST_M_S]), body_velocity_m_s=BODY_M_S)
    t_ns = round(age_s * 1e9)
    wrist_m = last.moving_at(t_ns)[1] - xyz[1]
    expected_m = WRIST_M_S * age_s if by_its_own_speed else last.at(t_ns)[1] - xyz[1]
    np.testing.assert_allclose(wrist_m, expected_m)


def test_a_body_continues_at_its_speed_at_first_and_stops_within_a_step() -> None:
    last = LastSeen(person_id=0, t_ns=0, xyz_world=np.zeros((1, 3)), velocity_m_s=BODY_M_S[None], body_velocity_m_s=BODY_M_S)
    np.testing.assert_allclose(last.at(1_000_000)[0], 1e-3 * BODY_M_S, rtol=1e-2)
    assert 0.3 < np.linalg.norm(last.at(10_000_000_000)[0]) < 0.5
    np.testing.assert_array_equal(last.at(-1), last.xyz_world)


def test_speeds_are_learnt_from_one_measurement_to_the_next() -> None:
    """Of a body that walks and a wrist that swings; the speed of the body is averaged, one that no person has is bounded."""
    start = np.zeros((3, 3))
    last = LastSeen.first(0, 10**12, start)
    for step in range(1, 31):
        t_s = step / 30
        last = last.measured(10**12 + round(t_s * 1e9), start + t_s * np.stack([BODY_M_S, BODY_M_S, WRIST_M_S]))
    np.testing.assert_allclose(last.velocity_m_s, [BODY_M_S, BODY_M_S, WRIST_M_S], atol=1e-6)
    np.testing.assert_allclose(last.body_velocity_m_s, BODY_M_S, rtol=0.01)
    jumped = last.measured(last.t_ns + 33_333_333, last.xyz_world + 5.0)
    assert np.linalg.norm(jumped.body_velocity_m_s) < 6.0

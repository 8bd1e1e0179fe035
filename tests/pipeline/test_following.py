"""Following people through a recording: when views have image regions, and when whole images are searched."""

import dataclasses
import weakref
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from built import detections, standing, turned
from checks import refusal
from videos import write_video

from posefuse.association import AssociateSettings, with_persons
from posefuse.core import DetectionBatch, Detections2D, LookKind, Observations, Pose3D, Rig, SourceError
from posefuse.core.observations import NOT_KEPT
from posefuse.core.skeleton import COCO17
from posefuse.core.values import keypoint_boxes
from posefuse.fusion import FuseSettings
from posefuse.pipeline.following import Followed, PeopleFollower, observations_of
from posefuse.pipeline.time_steps import ImageStep, ImageTimeSteps, common_timeline, stored_steps
from posefuse.pipeline.track import others_line, others_seen
from posefuse.sources.video import VideoConfig, VideoSource

K = len(COCO17)
PERIOD_NS = 33_333_333


@dataclass(frozen=True)
class Step:
    """A time step of a stage."""

    stage: "Stage"
    i: int

    @property
    def t_ns(self) -> int:
        return self.i * PERIOD_NS

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        assert (kind == LookKind.SEARCH) == (expected is None)
        return tuple(self.stage.look(self.i, expected))


class Stage:
    """People on a stage, seen perfectly by every camera that looks where they are or searches; keeps count of its searches."""

    skeleton = COCO17
    # a view that looks farther off than so sees no person
    near_m = 0.3

    def __init__(self, rig: Rig, present: dict[int, range], blind: tuple[int, ...] = (), count: int = 30) -> None:
        rng = np.random.default_rng(2)
        self.rig, self.present, self.blind, self.count = rig, present, blind, count
        self.people = {p: rng.normal(size=(K, 3)) * [0.2, 0.2, 0.4] + [1.5 * p, 0, 1] for p in present}
        self.searches: list[int] = []

    def __iter__(self) -> Iterator[Step]:
        for i in range(self.count):
            yield Step(self, i)

    def xyz(self, i: int) -> dict[int, np.ndarray]:
        return {p: body + [0.02 * i, 0, 0] for p, body in self.people.items() if i in self.present[p]}

    def look(self, i: int, pose: Pose3D | None) -> list[Detections2D]:
        if pose is None:
            self.searches.append(i)
        return [self.view(i, c, pose) for c in range(len(self.rig))]

    def view(self, i: int, c: int, pose: Pose3D | None) -> Detections2D:
        here = self.xyz(i)
        if pose is None:
            shown = [] if c in self.blind else [here[p] for p in here]
        else:
            shown = [self.near(here, expected) for expected in pose.xyz_world]
        xy = np.array([self.rig.cameras[c].project(xyz) for xyz in shown]).reshape(-1, K, 2)
        seen = np.isfinite(xy[..., 0])
        about = {"sigma_px": np.where(seen, 1.5, np.nan), "box_img": keypoint_boxes(xy, seen.astype(float))}
        return detections(self.rig.names[c], xy, i * PERIOD_NS, score=1.0, **about)

    def near(self, here: dict[int, np.ndarray], expected: np.ndarray) -> np.ndarray:
        for xyz in here.values():
            if np.linalg.norm(np.nanmean(expected - xyz, axis=0)) < self.near_m:
                return xyz
        return np.full((K, 3), np.nan)


def followed(stage: Stage, people: int = 1) -> list:
    one = follower(stage.rig, people)
    return identified(one, one.follow(stage))


def identified(follower: PeopleFollower, steps: Iterable[Followed]) -> list[Followed]:
    """The time steps with people instead of tracks, by all that is known at the end."""
    found = []
    for one in list(steps):
        tracks = (one.pose.person_id, *one.person_ids)
        people, *ids = (follower.people_of(some, np.full(len(some), one.pose.t_ns)) for some in tracks)
        found.append(dataclasses.replace(one, person_ids=tuple(ids), pose=with_persons(one.pose, people.tolist())))
    return found


def follower(rig: Rig, people: int) -> PeopleFollower:
    return PeopleFollower(skeleton=COCO17, rig=rig, associating=AssociateSettings(max_people=people), fusing=FuseSettings())


def test_one_search_then_the_pose_gives_every_view_its_region(ring_rig) -> None:
    stage = Stage(ring_rig(4), {0: range(30)})
    seen = followed(stage)
    assert stage.searches == [0]
    for i, one in enumerate(seen):
        assert np.allclose(one.pose.xyz_world[0], stage.xyz(i)[0], atol=1e-4)
        assert (one.pose.n_views == 4).all()


def test_views_whose_search_finds_no_person_contribute_from_the_first_time_step(ring_rig) -> None:
    seen = followed(Stage(ring_rig(4), {0: range(30)}, blind=(1, 3)))
    assert (seen[0].pose.n_views == 4).all()
    assert np.isfinite(seen[0].views.xy_img).all()


def test_a_person_lost_is_searched_at_once_then_now_and_then(ring_rig) -> None:
    stage = Stage(ring_rig(4), {0: range(8)}, count=30)
    seen = followed(stage)
    assert [len(one.pose.person_id) for one in seen[:8]] == [1] * 8
    assert stage.searches[1] == 8
    assert len(stage.searches) <= 1 + 1 + (30 - 8) // 5 + 1


def test_a_person_who_returns_is_followed_again_under_the_same_name(ring_rig) -> None:

    stage = Stage(ring_rig(4), {0: range(30)})
    stage.present = {0: [*range(6), *range(12, 30)]}
    seen = followed(stage)
    assert [len(one.pose.person_id) for one in seen[6:11]] == [0] * 5
    back = [i for i, one in enumerate(seen) if i >= 12 and len(one.pose.person_id)]
    assert back[0] <= 12 + 5
    assert {int(one.pose.person_id[0]) for one in seen if len(one.pose.person_id)} == {0}


def test_a_second_person_who_enters_is_found_while_the_first_is_followed(ring_rig) -> None:
    stage = Stage(ring_rig(5), {0: range(30), 1: range(10, 30)})
    seen = followed(stage, people=2)
    assert [len(one.pose.person_id) for one in seen[:10]] == [1] * 10
    assert all(len(one.pose.person_id) == 2 for one in seen[16:])
    assert len(stage.searches) < 12


def test_no_person_at_all_is_no_error_and_not_searched_every_time(ring_rig) -> None:
    stage = Stage(ring_rig(3), {0: range(0)}, count=20)
    seen = followed(stage)
    assert [len(one.pose.person_id) for one in seen] == [0] * 20
    assert len(stage.searches) == 4


@pytest.mark.parametrize("blind", [(), (1, 3)])
def test_the_log_answers_as_the_detector_did(ring_rig, blind: tuple[int, ...]) -> None:
    stage = Stage(ring_rig(4), {0: range(30), 1: range(5, 30)}, blind)
    stage.present = {0: [*range(7), *range(13, 30)], 1: range(5, 30)}
    first = followed(stage, people=2)
    log, asked = observations_of(first, COCO17, stage.rig), len(stage.searches)
    second = follower(stage.rig, 2)
    again = identified(second, second.follow(stored_steps(log)))
    assert len(stage.searches) == asked, "the detector is not asked again"
    for one, other in zip(first, again, strict=True):
        assert [batch.kind for batch in one.batches] == [batch.kind for batch in other.batches]
        np.testing.assert_array_equal(one.pose.xyz_world, other.pose.xyz_world)
    ids = observations_of(again, COCO17, stage.rig).person_id
    np.testing.assert_array_equal(ids, log.person_id)


def test_a_look_that_was_not_taken_is_answered_by_all_that_is_known_of_the_frame(ring_rig) -> None:
    """Followed alone, one person is in the log of most frames; the other only where whole images were searched."""
    stage = Stage(ring_rig(4), {0: range(30), 1: range(30)})
    log = observations_of(followed(stage, people=1), COCO17, stage.rig)
    step = next(iter(stored_steps(log)))
    kinds = log.frame_look[step.frames]
    assert set(kinds) == {LookKind.EXPECTED, LookKind.SEARCH}
    assert [len(found) for found in step.look(LookKind.SECOND, None)] == [2] * 4
    both = list(follower(stage.rig, 2).follow(stored_steps(log)))
    assert len(both[0].pose.person_id) == 2
    assert all(len(one.pose.person_id) == 1 for one in both[1:])


def test_the_timeline_is_in_phase_with_the_fastest_camera_and_covers_all() -> None:
    slow, fast = np.arange(0, 20) * 40_000_000 + 3_000_000, np.arange(10, 40) * 20_000_000
    line = common_timeline({"slow": slow, "fast": fast}, None, None, None)
    assert line.period_ns == 20_000_000
    assert (line.start_ns - fast[0]) % line.period_ns == 0
    assert line.start_ns <= slow[0] + line.period_ns // 2
    last_ns = line.start_ns + (line.count - 1) * line.period_ns
    assert abs(last_ns - max(slow[-1], fast[-1])) <= line.period_ns // 2
    part = common_timeline({"slow": slow, "fast": fast}, 10.0, 0.3, 0.5)
    assert [part.t_ns(i) for i in range(part.count)] == [300_000_000, 400_000_000, 500_000_000]
    # periods are whole nanoseconds: after 60 of them 2 s are 20 ns away
    thirds = np.round(np.arange(100) * 1e9 / 30).astype(np.int64)
    assert common_timeline({"cam": thirds}, None, 2.0, None).start_ns == 60 * 33_333_333
    with pytest.raises(SourceError, match=r"from 5 s until 6 s; the recording runs from 0\.003"):
        common_timeline({"slow": slow, "fast": fast}, None, 5.0, 6.0)


def test_the_number_of_time_steps_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ns = {"a": np.arange(100) * 33_333_333, "b": np.arange(100) * 33_333_333}
    assert common_timeline(times_ns, 1000.0, None, None).count > 3000
    late = times_ns | {"b": times_ns["b"] + 3 * 10**18}
    refusal(SourceError, r"9e\+10 time steps", common_timeline, late, None, None, None)
    monkeypatch.setattr("posefuse.pipeline.time_steps._MOST_TIME_STEPS", 1000)
    with pytest.raises(SourceError, match=r"3301 time steps \(3\.301 s at 1000 Hz\); expected at most 1000: check rate_hz"):
        common_timeline(times_ns, 1000.0, None, None)


@pytest.mark.parametrize("early_ms", [3, 8, 13, 18, 199])
def test_the_first_time_step_is_the_one_nearest_to_the_first_frame(early_ms: int) -> None:
    fast = np.arange(10, 40) * 20_000_000
    line = common_timeline({"early": np.array([early_ms * 1_000_000]), "fast": fast}, None, None, None)
    assert abs(line.start_ns - early_ms * 1_000_000) <= line.period_ns // 2


def test_single_images_have_time_steps_of_a_usual_camera() -> None:
    line = common_timeline({"a": np.array([0]), "b": np.array([100_000_000])}, None, None, None)
    assert (line.period_ns, line.count) == (33_333_333, 4)


@pytest.mark.parametrize("to_ns", [1_000, 1_000_000])
def test_the_rate_is_that_of_the_camera_however_its_file_rounds_times(to_ns: int) -> None:
    frames = np.delete(np.arange(3000), [7, 1200, 1201])
    line = common_timeline({"cam": np.round(frames * 1e9 / 30 / to_ns).astype(np.int64) * to_ns}, None, None, None)
    assert line.period_ns == pytest.approx(1e9 / 30, rel=1e-6)
    assert line.count == 3000


class Reflection(Stage):
    """What only the first two cameras see, although the others have the same part of the room in their image."""

    def view(self, i: int, c: int, pose: Pose3D | None) -> Detections2D:
        return super().view(i, c, pose) if c < 2 else Detections2D.empty(self.rig.names[c], i * PERIOD_NS, COCO17)


@pytest.mark.parametrize(("cameras", "outside", "count"), [(3, 0, 1), (4, 0, 1), (5, 0, 0), (5, 1, 1)])
def test_a_newcomer_of_two_views_is_dropped_when_three_others_see_no_person_there(
    ring_rig, cameras: int, outside: int, count: int
) -> None:
    """`outside`: of the other cameras, how many do not have the place in their image."""
    rig = ring_rig(cameras)
    for c in range(cameras - outside, cameras):
        rig = turned(rig, c, [0.0, np.pi, 0.0])
    stage = Reflection(rig, {0: range(3)}, count=3)
    stage.people[0] = standing()
    assert [len(one.pose.person_id) for one in followed(stage)] == [count] * 3


class Runner(Stage):
    """One person who gathers speed to 5.4 m/s."""

    near_m = 0.15

    def xyz(self, i: int) -> dict[int, np.ndarray]:
        ramp = np.minimum(0.012 * np.arange(i + 1), 0.18)
        return {p: body + [ramp.sum() - 2.5, 0, 0] for p, body in self.people.items()}


def test_a_runner_is_looked_for_where_the_next_step_leads(ring_rig) -> None:
    stage = Runner(ring_rig(4), {0: range(30)})
    seen = followed(stage)
    assert stage.searches == [0], "lost for no frame"
    assert all(len(one.pose.person_id) == 1 for one in seen)


def names_at(stage: Stage, i: int, seen: list) -> dict[int, int]:
    """By person of the stage, the id of the pose that is where the person is at step i."""
    pose = seen[i].pose
    found = {}
    for p, xyz in stage.xyz(i).items():
        apart = [np.nanmedian(np.linalg.norm(one - xyz, axis=-1)) for one in pose.xyz_world]
        if apart and min(apart) < 0.05:
            found[p] = int(pose.person_id[int(np.argmin(apart))])
    return found


class Walkers(Stage):
    """Two people side by side, 0.9 m apart, at 1.2 m/s; each is hidden from all cameras for a while."""

    def xyz(self, i: int) -> dict[int, np.ndarray]:
        bodies = {p: self.people[0] - [0, 0.9 * p, 0] for p in self.present}
        return {p: body + [0.04 * i, 0, 0] for p, body in bodies.items() if i in self.present[p]}


def test_two_people_hidden_for_a_moment_come_back_under_their_own_ids(ring_rig) -> None:
    """0.12 s and 0.27 s, overlapping: the person who is missing from the newest pose is not forgotten."""
    stage = Walkers(ring_rig(5), {0: range(40), 1: range(40)}, count=40)
    stage.present = {0: [*range(12), *range(16, 40)], 1: [*range(14), *range(22, 40)]}
    seen = followed(stage, people=2)
    names = names_at(stage, 0, seen)
    assert sorted(names.values()) == [0, 1]
    assert [names_at(stage, i, seen) for i in (5, 11, 25, 39)] == [names] * 4
    assert names_at(stage, 18, seen) == {0: names[0]}


class Crossing(Stage):
    """Two people meet at 0.3 m; where both are expected, a view marks the nearer one twice."""

    def xyz(self, i: int) -> dict[int, np.ndarray]:
        x = -0.9 + 0.06 * i
        return {0: self.people[0] + [x, 0.15, 0], 1: self.people[0] + [-x, -0.15, 0]}

    def view(self, i: int, c: int, pose: Pose3D | None) -> Detections2D:
        """Around the meeting every other view sees but one of the two, for whichever region it is asked."""
        seen = super().view(i, c, pose)
        if pose is None or not (11 <= i <= 19 and c % 2) or len(seen) < 2:
            return seen
        xy, score, sigma = seen.xy_img[[0, 0]], seen.score[[0, 0]], seen.sigma_px[[0, 0]]
        return dataclasses.replace(seen, xy_img=xy, score=score, sigma_px=sigma, box_img=seen.box_img[[0, 0]])


def test_one_body_that_is_marked_twice_does_not_become_both_people(ring_rig) -> None:
    stage = Crossing(ring_rig(5), {0: range(30), 1: range(30)})
    seen = followed(stage, people=2)
    names = names_at(stage, 0, seen)
    assert sorted(names.values()) == [0, 1]
    for i in range(30):
        assert names_at(stage, i, seen) == names, i


def test_two_who_stand_together_stay_two_where_a_search_has_to_be_put_together(ring_rig) -> None:
    """The stored answer to a look that was not taken has bodies several times: each is taken once, though the boxes overlap."""
    rig = ring_rig(3)
    stage = Stage(rig, {0: range(9), 1: range(9)})
    close = {0: stage.people[0], 1: stage.people[0] + [0.0, 0.0, 0.35]}
    stage.people = close
    everybody = stage.look(0, None)
    again = [dataclasses.replace(one, xy_img=one.xy_img + 1.0) for one in everybody]
    no_person = [Detections2D.empty(one.camera, one.t_ns, COCO17) for one in everybody]
    looks = [
        DetectionBatch(step=0, t_ns=0, kind=LookKind.SECOND, detections=tuple(found)) for found in (again, everybody, no_person)
    ]
    [seen] = follower(rig, 2).follow(stored_steps(Observations.from_batches(COCO17, rig.names, looks)))
    assert len(seen.pose.person_id) == 2
    for ids in seen.person_ids:
        assert len(ids) == 4
        assert sorted(ids[ids != NOT_KEPT]) == sorted(seen.pose.person_id)


# --- people seen but not asked for


BODY = np.random.default_rng(4).uniform([0, 0], [60, 200], (K, 2))


def view(camera: str, *left_px: float) -> Detections2D:
    xy = np.stack([BODY + [x, 0] for x in left_px]) if left_px else np.zeros((0, K, 2))
    return detections(camera, xy, score=1.0, sigma_px=1.0, box_img=np.zeros((len(xy), 4)))


def log(search: list[Detections2D], second: list[Detections2D], kept: list[list[int]]) -> Observations:
    """One time step: a search, then a second look whose detections are the people `kept`."""
    looks = ((LookKind.SEARCH, search), (LookKind.SECOND, second))
    batches = [DetectionBatch(step=0, t_ns=0, kind=kind, detections=tuple(views)) for kind, views in looks]
    no_person = [np.full(len(one), -1) for one in search]
    return Observations.from_batches(COCO17, ("a", "b", "c"), batches).with_person_ids(np.concatenate([*no_person, *kept]))


def test_who_was_found_but_is_not_in_the_result() -> None:
    search = [view("a", 0, 300, 600), view("b", 300, 2), view("c", 0)]
    made = log(search, [view("a", 1), view("b", 3), view("c", 1)], [[0], [0], [0]])
    assert others_seen(made, AssociateSettings()) == {"a": 2, "b": 1}


def test_a_person_of_the_result_whom_a_view_does_not_count_for_is_no_other() -> None:
    both = [view("a", 0, 300), view("b", 0, 300), view("c")]
    made = log(both, [view("a", 1), view("b", 301), view("c")], [[0], [1], []])
    assert others_seen(made, AssociateSettings()) == {}


def test_a_body_found_twice_is_no_other() -> None:
    made = log([view("a", 0, 1.5), view("b"), view("c")], [view("a", 1), view("b"), view("c")], [[0], [], []])
    assert others_seen(made, AssociateSettings()) == {}


def test_one_line_names_the_cameras_and_one_camera_alone_is_not_reported() -> None:
    line = others_line({"a": 2, "b": 1}, 1)
    assert line == "up to 2 more people were seen than the 1 followed: a (2), b (1); `people=N` follows more"
    assert others_line({"a": 3}, 1) is None
    assert others_line({}, 1) is None


# --- what --resume decodes: from the key frame before the first time step that is missing, where all before it is known


COUNT, GOP, DONE = 96, 12, 70


def log_of(steps: list[ImageStep], rig: Rig) -> Observations:
    """Of steps in which no person was found."""
    batches = []
    for i, step in enumerate(steps):
        found = tuple(Detections2D.empty(one.camera, one.t_ns, COCO17) for one in step.frames if one)
        batches.append(DetectionBatch(step=i, t_ns=step.t_ns, kind=LookKind.SEARCH, detections=found))
    return Observations.from_batches(COCO17, rig.names, batches)


class Detector:
    """Looks at nothing."""


def time_steps(rig: Rig, path: Path, detector: Any) -> ImageTimeSteps:
    """Of a video that all cameras share."""
    write_video(path, [np.full((48, 64, 3), 2 * i, np.uint8) for i in range(COUNT)], "mpeg4", options={"g": str(GOP)})
    sources = [VideoConfig(path, name).build() for name in rig.names]
    line = common_timeline({one.camera: one.times_ns() for one in sources}, None, None, None)
    return ImageTimeSteps(rig, sources, detector, line, None)


def test_the_detector_is_let_go_before_the_solve(ring_rig: Callable[..., Rig], tmp_path: Path) -> None:
    """Its network would take memory that an hour needs."""
    detector = Detector()
    images, held = time_steps(ring_rig(2), tmp_path / "a.mp4", detector), weakref.ref(detector)
    del detector
    assert len(list(images.steps())) == COUNT and held() is not None
    images.close()
    assert held() is None


@pytest.mark.parametrize("missing", [False, True])
def test_few_frames_before_the_first_missing_one_are_decoded(ring_rig, tmp_path, monkeypatch, missing: bool) -> None:
    rig, decoded, real = ring_rig(2), [0], VideoSource._decoded_frames

    def counting(*arguments: Any) -> Iterator[Any]:
        for one in real(*arguments):
            decoded[0] += 1
            yield one

    images = time_steps(rig, tmp_path / "a.mp4", Detector())
    whole = list(images.steps())
    log = log_of(whole[:DONE], rig)
    if missing:  # one frame whose detections are not known, as where it could not be read
        log = log.only(np.arange(len(log.frame_t_ns)) != 9)
    monkeypatch.setattr(VideoSource, "_decoded_frames", counting)
    rest = list(images.steps(log))
    assert [step.t_ns for step in rest] == [step.t_ns for step in whole[DONE:]] and len(rest) == COUNT - DONE
    for one, other in zip(rest, whole[DONE:], strict=True):
        for mine, theirs in zip(one.frames, other.frames, strict=True):
            np.testing.assert_array_equal(mine.image, theirs.image)
    least = COUNT if missing else COUNT - DONE
    assert least + COUNT - DONE <= decoded[0] <= least + COUNT - DONE + 2 * (GOP + 2)

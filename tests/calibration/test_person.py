"""A rig from a person alone: a person who walks before four known cameras, as keypoints with noise."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from built import detections, turned
from checks import refusal
from studies import write_openpose
from synthetic_walk import BODY, STATURE_M, walker
from synthetic_walk import watch_walker as watched
from videos import ScriptedSource

import posefuse as pf
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks, prominent
from posefuse.calibration.extrinsics.prop_solve import focal_change
from posefuse.calibration.extrinsics.world import floor_from_feet
from posefuse.calibration.geometry import poses_of
from posefuse.calibration.person.checks import check_standing
from posefuse.calibration.person.keypoint_solve import let_free, solve_person_bundle
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import (
    PersonCalibration,
    _floor,
    at_clocks,
    calibrate_from_person,
    calibrate_tracks,
    rough_rig,
    unplaced_clocks,
)
from posefuse.calibration.person.views import ChosenPerson, PersonViews, choose_person, people_tracks, person_views
from posefuse.calibration.report import RefusedCalibration
from posefuse.core import SE3, Camera, Detections2D, Rig, Skeleton
from posefuse.formats.rig import write_rig
from posefuse.pipeline.calibration import solve_person
from posefuse.pipeline.person_poses import PersonSeen, timeline_of

LENGTH = KnownLength(stature_m=STATURE_M)


def test_a_walk_gives_the_rig_and_its_stature_the_scale(lab: Any) -> None:
    rig = calibrated_alone(lab, watched(lab.rig)).rig
    millimetres, degrees = lab.errors(rig, scaled=True)
    assert millimetres.max() < 8
    assert degrees.max() < 0.1
    assert lab.errors(rig)[0].max() < 0.02 * 4500
    assert (rig.centres_world()[:, 2] > 1.5).all()


def test_the_distance_of_two_cameras_gives_the_scale(lab: Any) -> None:
    apart_m = float(np.linalg.norm(lab.rig["cam00"].centre_world - lab.rig["cam02"].centre_world))
    rig = calibrate_from_person(watched(lab.rig), lab.rig.cameras, KnownLength(apart=("cam00", "cam02", apart_m))).rig
    assert lab.errors(rig)[0].max() < 10


def calibrated_alone(lab: Any, views: PersonViews) -> PersonCalibration:
    return calibrate_from_person(views, lab.rig.cameras, LENGTH)


def test_focal_lengths_and_clocks_let_free_scatter_as_their_standard_errors_say(lab: Any) -> None:
    off = []
    for seed in range(4):
        views = watched(lab.rig, seconds=10.0, seed=seed)
        free = let_free(solve_person_bundle(views, lab.rig.cameras), focal=True)
        late, late_sigma = free.solution.state.delay_s[:, 0], free.solution.delay_sigma_s[:, 0]
        value, sigma = (np.concatenate(pair) for pair in zip(focal_change(free), (late, late_sigma), strict=True))
        moving = sigma > 0
        assert moving.sum() == 2 * len(lab.rig) - 1
        off.append((value / np.where(moving, sigma, 1.0))[moving])
    # 28 standardised errors; few stretches of time make their standard errors too large rather than too small
    assert 0.3 < float(np.sqrt(np.mean(np.square(off)))) < 1.6


@pytest.mark.slow
def test_swapped_sides_and_wild_keypoints_do_little_harm(lab: Any) -> None:
    views, random = watched(lab.rig), np.random.default_rng(1)
    turned = random.random(views.score.shape[:2]) < 0.1
    xy = np.where(turned[..., None, None], views.xy_img[:, :, BODY.mirror], views.xy_img)
    wild = random.random(views.score.shape) < 0.05
    xy = np.where(wild[..., None], random.uniform(0, 480, xy.shape), xy)
    rig = calibrated_alone(lab, replace(views, xy_img=xy)).rig
    assert lab.errors(rig, scaled=True)[0].max() < 15


def test_only_the_ratios_of_the_stated_noise_count(lab: Any) -> None:
    views = watched(lab.rig, seconds=4.0)
    one, other = (rough(replace(views, sigma_px=k * views.sigma_px), lab.rig) for k in (1.0, 4.0))
    np.testing.assert_array_equal(one.centres_world(), other.centres_world())
    uneven = np.where(np.arange(len(BODY)) % 2, 1.0, 3.0)
    assert not np.array_equal(
        rough(replace(views, sigma_px=uneven * views.sigma_px), lab.rig).centres_world(), one.centres_world()
    )


@pytest.mark.slow
def test_mirrored_videos_are_refused_by_name(lab: Any) -> None:
    views, width = watched(lab.rig), lab.rig.cameras[0].size_wh[0]
    flipped = replace(views, xy_img=views.xy_img * [-1, 1] + [width - 1, 0])
    words = "nothing is mirrored: the person has left, front and up where they belong 0%"
    refusal(RefusedCalibration, words, calibrated_alone, lab, flipped)


def test_a_camera_that_sees_no_person_or_another_person_is_named(lab: Any) -> None:
    views = watched(lab.rig)
    # a person who follows half a lap behind looks much like the other from the other side
    other = lab.rig["cam03"].project(walker(views.t_ns / 1e9 + 3.0, (0.8, 0.5)))
    for seen, words in ((np.nan, r"no person found by cam03 \(0 of 48 frames\)"), (other, "cam03 agrees worst")):
        xy = views.xy_img.copy()
        xy[3] = seen
        refusal(RefusedCalibration, words, calibrated_alone, lab, replace(views, xy_img=xy))


def test_the_person_followed_is_the_large_one_and_then_the_near_one() -> None:
    xy = np.stack([np.full((17, 2), 100.0), np.full((17, 2), 300.0), np.full((17, 2), np.nan)])
    xy[0, :8] += 50
    xy[1, :8] += 90
    seen = detections("a", xy, sigma_px=1.0)
    assert prominent(seen) == 1
    assert prominent(seen, np.array([100.0, 100.0])) == 0
    assert prominent(replace(seen, xy_img=np.full((3, 17, 2), np.nan))) is None
    views = person_views(person_tracks({"a": [seen], "b": [replace(seen, camera="b", xy_img=xy[[2, 2, 0]])]}))
    np.testing.assert_array_equal(views.xy_img[:, 0, 0], [[390, 390], [150, 150]])
    assert views.sigma_px[0, 0, 0] == 1


def rough(views: PersonViews, rig: Rig) -> Rig:
    return rough_rig(views, rig.cameras, LENGTH)


def test_a_person_who_stays_in_one_place_is_refused_and_a_line_will_do(lab: Any) -> None:
    views = watched(lab.rig)
    t_s = views.t_ns / 1e9

    def seen(xyz: np.ndarray) -> PersonViews:
        noise = np.random.default_rng(4).normal(0, 1, views.xy_img.shape)
        return replace(views, xy_img=np.stack([camera.project(xyz) for camera in lab.rig]) + noise)

    words = r"the person walks about: the hips spread over 0\.\d\d m"
    refusal(RefusedCalibration, words, calibrated_alone, lab, seen(walker(t_s, lap_rad_s=0.0)))
    ahead = walker(t_s, lap_rad_s=0.0) + np.array([0, 0.15, 0]) * (t_s[:, None, None] - 6)
    rig = calibrated_alone(lab, seen(ahead)).rig
    assert rig.world_set_by == "up along the body, floor under the feet"
    assert lab.errors(rig, scaled=True)[0].max() < 40


def tracks_of(rig: Rig, offset_s: np.ndarray) -> list[PersonTrack]:
    """A person on an ellipse in one sense, where an offset is nearly another place of the camera."""
    random, stamps = np.random.default_rng(2), np.arange(120) / 12
    seen = [camera.project(walker(stamps - offset)) for camera, offset in zip(rig, offset_s, strict=True)]
    every = np.ones(seen[0].shape[:2])
    return [
        PersonTrack(name, BODY, np.round(stamps * 1e9), xy + random.normal(0, 1, xy.shape), 0.9 * every, every)
        for name, xy in zip(rig.names, seen, strict=True)
    ]


def test_cameras_synchronised_are_taken_so(lab: Any) -> None:
    for late_s, clocks in ((np.zeros(4), "auto"), (np.arange(4.0), "together")):
        assert unplaced_clocks(tracks_of(lab.rig, late_s), lab.rig.cameras, LENGTH, clocks, 1.0) is None


@pytest.mark.slow
def test_rig_and_clocks_come_from_the_person_alone(lab: Any) -> None:
    late_s = np.array([0.0, 0.147, -0.11, 0.05])
    tracks = tracks_of(lab.rig, late_s)
    first = unplaced_clocks(tracks, lab.rig.cameras, LENGTH, "auto", 1.0)
    found, clocks = calibrate_tracks(at_clocks(tracks, first), lab.rig.cameras, LENGTH, first, with_drift=False)
    np.testing.assert_allclose(clocks.offset_s, late_s, atol=0.004)
    assert (np.abs(clocks.offset_s - late_s) <= 4 * clocks.offset_sigma_s).all()
    assert lab.errors(found.rig, scaled=True)[0].max() < 15
    assert {"parts agree", "clocks are determined"} <= {check.name for check in found.report.checks}


def test_the_world_does_not_matter(lab: Any) -> None:
    elsewhere = lab.rig.moved(SE3.from_rotvec([0.4, -0.3, 1.0], [2.0, 1.0, -0.5]))
    views = watched(lab.rig, seconds=4.0)
    one, other = (rough(views, rig) for rig in (lab.rig, elsewhere))
    np.testing.assert_array_equal(one.centres_world(), other.centres_world())


def test_the_random_numbers_of_opencv_are_left_alone_and_change_nothing(lab: Any) -> None:
    found, drawn = [], []
    for seed in (1, 2):
        cv2.setRNGSeed(seed)
        drawn.append(cv2.randu(np.zeros(4), 0, 1).ravel())
        cv2.setRNGSeed(seed)
        found.append(poses_of(rough(watched(lab.rig), lab.rig)).t)
        np.testing.assert_array_equal(cv2.randu(np.zeros(4), 0, 1).ravel(), drawn[-1])
    np.testing.assert_array_equal(*found)


# --- a rig from a person while another one walks about in the same views: one of them is taken in all cameras, or it is refused


T_S = np.arange(72) / 6.0


def walks() -> tuple[np.ndarray, np.ndarray]:
    """(T, 17, 3) of two people who cross each other's way."""
    return walker(T_S), walker(0.8 * T_S + 3.3, (0.5, 0.4), lap_rad_s=-0.8)


def frames_of(camera: Camera, people: Sequence[np.ndarray], seed: int) -> list[Detections2D]:
    """Everybody in a camera's frames, in an order that changes from frame to frame."""
    random, frames = np.random.default_rng(seed), []
    seen = np.stack([camera.project(xyz) for xyz in people], axis=1)
    seen = seen + random.normal(0, 1.0, seen.shape)
    for t_s, xy in zip(T_S, seen, strict=True):
        order = random.permutation(len(people))
        frames.append(detections(camera.name, xy[order], round(t_s * 1e9), sigma_px=1.0))
    return frames


def all_watched(rig: Rig, who: Sequence[Sequence[int]]) -> dict[str, list[Detections2D]]:
    """Which of the two people each camera sees."""
    both = walks()
    seen = enumerate(zip(rig, who, strict=True))
    return {camera.name: frames_of(camera, [both[p] for p in people], seed=c) for c, (camera, people) in seen}


def followed(rig: Rig, chosen: ChosenPerson) -> list[int]:
    """Which person each camera's track is, by the median distance to each."""
    people = []
    for camera, track in zip(rig, chosen.tracks, strict=True):
        away = [np.nanmedian(np.linalg.norm(track.xy_img - camera.project(xyz), axis=-1)) for xyz in walks()]
        assert min(away) < 3 < 10 < max(away)
        people.append(int(np.argmin(away)))
    return people


def calibrated(rig: Rig, chosen: ChosenPerson) -> PersonCalibration:
    seen = PersonSeen(tracks=chosen.tracks, cameras=rig.cameras, clocks=None, several_in=chosen.several_in)
    return solve_person(seen, LENGTH, with_drift=False)[0]


def test_of_two_people_one_is_taken_in_all_cameras(lab: Any) -> None:
    chosen = choose_person(all_watched(lab.rig, [(0, 1)] * 4), lab.rig.cameras)
    assert len(set(followed(lab.rig, chosen))) == 1


@pytest.mark.slow
def test_the_rig_from_one_of_two_people_is_as_good_as_from_one_alone(lab: Any) -> None:
    chosen = choose_person(all_watched(lab.rig, [(0, 1)] * 4), lab.rig.cameras)
    found = calibrated(lab.rig, chosen)
    millimetres, degrees = lab.errors(found.rig)
    assert millimetres.max() < 0.02 * 4500
    assert degrees.max() < 0.15
    assert "several people are in view of cam00, cam01, cam02, cam03" in " ".join(found.report.notes)


def test_the_person_whom_all_cameras_see_is_taken(lab: Any) -> None:
    assert choose_person(all_watched(lab.rig, [(0,)] * 4), lab.rig.cameras).several_in == ()
    for everywhere in (0, 1):
        who = [(0, 1), (0, 1), (everywhere,), (0, 1)]
        assert followed(lab.rig, choose_person(all_watched(lab.rig, who), lab.rig.cameras)) == [everywhere] * 4


@pytest.mark.slow
def test_where_no_person_is_in_all_cameras_it_is_refused_by_name(lab: Any) -> None:
    seen = all_watched(lab.rig, [(0, 1), (0,), (0, 1), (1,)])
    refusal(RefusedCalibration, "one person in view", lambda: calibrated(lab.rig, choose_person(seen, lab.rig.cameras)))


def test_people_are_followed_through_frames_without_them(lab: Any) -> None:
    camera = lab.rig.cameras[0]
    frames = frames_of(camera, walks(), seed=5)
    gone = [frame.people(np.zeros(0, np.int64)) if 30 <= i < 34 else frame for i, frame in enumerate(frames)]
    tracks = people_tracks(camera.name, gone)
    assert len(tracks) == 2
    for track in tracks:
        assert np.isnan(track.xy_img[30:34]).all()
        there = np.isfinite(track.xy_img).all(axis=(1, 2))
        away = [np.linalg.norm(track.xy_img - camera.project(xyz), axis=-1)[there] for xyz in walks()]
        assert min(np.median(one, axis=1).max() for one in away) < 4


def test_two_at_one_place_of_an_image_stay_two_tracks(lab: Any) -> None:
    """One in front and one half as large behind, about one point; left and right are swapped in some frames."""
    random, camera = np.random.default_rng(7), lab.rig.cameras[0]
    body = camera.project(walker(T_S[:1]))[0]
    body = body - np.median(body, axis=0)
    seen = np.stack([body, body / 2]) + 400 + random.normal(0, 3.0, (len(T_S), 2, len(BODY), 2))
    swapped = random.random((len(T_S), 2)) < 0.1
    seen[swapped] = seen[swapped][:, BODY.mirror]
    orders = [random.permutation(2) for _ in T_S]
    frames = [detections(camera.name, xy[o], round(t * 1e9), sigma_px=3.0) for t, xy, o in zip(T_S, seen, orders, strict=True)]
    tracks = people_tracks(camera.name, frames)
    assert len(tracks) == 2
    for track in tracks:
        away = np.linalg.norm(seen - track.xy_img[:, None], axis=-1).max(axis=-1)
        assert len(set(away.argmin(axis=1))) == 1


# --- a person as users calibrate from them: by the public function, in any order of the cameras, and with cameras that move


RATE_HZ, SECONDS = 12.0, 20.0
STAMPS_S = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ


def views_of(rig: Rig, seed: int = 0) -> PersonViews:
    return watched(rig, SECONDS, RATE_HZ, 1.5, seed, lap_rad_s=0.7)


def moved_at(rig: Rig, at_s: dict[int, float], degrees: float) -> PersonViews:
    views = views_of(rig)
    xy = views.xy_img.copy()
    for camera, at in at_s.items():
        late = at <= STAMPS_S
        xy[camera, late] = views_of(turned(rig, camera, np.deg2rad(degrees) * np.array([0, 0.8, 0.6]))).xy_img[camera, late]
    return replace(views, xy_img=xy)


def standing(rig: Rig, views: PersonViews) -> Any:
    return check_standing(solve_person_bundle(views, rig.cameras, 600))


@pytest.mark.parametrize("at_s", [10.0, 15.0])
def test_a_camera_that_turns_by_a_degree_is_named_with_the_time(lab: Any, at_s: float) -> None:
    assert standing(lab.rig, views_of(lab.rig)).passed
    check = standing(lab.rig, moved_at(lab.rig, {2: at_s}, 1.0))
    assert not check.passed
    found = re.fullmatch(r"cam02 was moved at about (\d+) s, its view by (\d\.\d) deg", check.detail)
    assert float(found[1]) == pytest.approx(at_s, abs=1.5)
    assert float(found[2]) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
def test_two_cameras_that_move_at_one_time_are_both_named(lab: Any) -> None:
    """In four cameras; an innocent one may be named with them, and two that move at different times may pass."""
    check = standing(lab.rig, moved_at(lab.rig, {0: 10.0, 2: 10.0}, 3.0))
    assert "cam00 was moved" in check.detail and "cam02 was moved" in check.detail


def written(folder: Path, rig: Rig, late_s: tuple[float, ...]) -> dict[str, Path]:
    """2D poses of each camera."""
    files, random = {camera.name: folder / camera.name for camera in rig}, np.random.default_rng(3)
    for camera, late in zip(rig, late_s, strict=True):
        xy = camera.project(walker(STAMPS_S - late, lap_rad_s=0.7))
        write_openpose(files[camera.name], dict(enumerate((xy + random.normal(0, 1, xy.shape))[:, None])))
    return files


@pytest.mark.slow
def test_the_order_of_the_cameras_changes_nothing(lab: Any, tmp_path: Path) -> None:
    rig = replace(lab.rig, cameras=lab.rig.cameras[:3])
    files, late_s = written(tmp_path, rig, (0.0, 0.1, -0.05)), {"cam00": 0.0, "cam01": 0.1, "cam02": -0.05}
    calibrate = partial(pf.calibrate_person, height_m=STATURE_M, rate_hz=RATE_HZ)
    orders = (("cam00", "cam01", "cam02"), ("cam02", "cam00", "cam01"))
    found = [calibrate({name: files[name] for name in order}, intrinsics=rig) for order in orders]
    assert found[0].rig.names == found[1].rig.names == rig.names
    np.testing.assert_array_equal(found[0].rig.centres_world(), found[1].rig.centres_world())
    assert found[0].clock_settings == found[1].clock_settings != ""
    # another camera as the first by name: other numbers, and the same within what is stated
    other = {"cam00": "z", "cam01": "y", "cam02": "x"}
    renamed = replace(rig, cameras=tuple(replace(camera, name=other[camera.name]) for camera in rig))
    again = calibrate({other[name]: path for name, path in files.items()}, intrinsics=renamed)
    for one, names in ((found[0], list(late_s)), (again, [other[name] for name in late_s])):
        offset_s = np.array([one.clocks.offset_s[one.rig.names.index(name)] for name in names])
        np.testing.assert_allclose(offset_s - offset_s[0], list(late_s.values()), atol=0.006)


@pytest.mark.slow
def test_the_order_of_the_cameras_does_not_change_clocks(lab: Any, tmp_path: Path) -> None:
    """Nor the rig from a target: `test_the_same_input_gives_the_same_rig`."""
    found = []
    for order in ((0, 1, 2, 3), (2, 3, 0, 1)):
        folder = tmp_path / str(order[0])
        (folder / "pose2d").mkdir(parents=True)
        rig = Rig(tuple(lab.rig.cameras[i] for i in order))
        write_rig(folder / "rig.toml", rig)
        written(folder / "pose2d", rig, tuple((0.0, 0.1, -0.05, 0.02)[i] for i in order))
        one = pf.calibrate_clocks(folder, rate_hz=RATE_HZ, max_offset_s=1.0)
        found.append(dict(zip(one.rig.names, one.clocks.offset_s, strict=True)))
    assert found[0] == pytest.approx(found[1], abs=1e-3)


def test_a_long_recording_is_cut_and_not_sampled_coarsely() -> None:
    def timeline(seconds: float, rate_hz: float, **more: float) -> Any:
        t_ns = (np.arange(round(seconds * rate_hz)) / rate_hz * 1e9).astype(np.int64)
        return timeline_of([ScriptedSource(camera, t_ns) for camera in "ab"], **more)

    long = timeline(150.0, 30.0)
    assert 1e9 / long.period_ns == pytest.approx(15, rel=0.01)
    assert long.count * long.period_ns / 1e9 == pytest.approx(60, abs=0.2)
    assert (long.start_ns + long.count * long.period_ns / 2) / 1e9 == pytest.approx(75, abs=0.2)
    assert timeline(20.0, 10.0).count == 200
    # a short one has its frames, in whole steps: 1.5 s of 60 Hz, and every second frame of 20 s
    assert [timeline(seconds, 60.0, steps=900).count for seconds in (1.5, 20.0)] == [90, 600]
    assert 1e9 / timeline(150.0, 60.0, steps=900).period_ns == pytest.approx(15, rel=0.01)


def test_the_floor_lies_under_the_soles(lab: Any) -> None:
    """Of a person who walks with flat feet, whose ankles are 85 mm above their heels and toes."""
    random = np.random.default_rng(0)
    feet = ("left_heel", "right_heel", "left_big_toe", "right_big_toe", "left_ankle", "right_ankle")
    place = np.column_stack([random.uniform(-1.5, 1.5, (300, 2)), np.zeros(300)])
    lifted_m = np.where(np.arange(300) % 2, 0.12, 0.0)
    body = np.repeat(place[:, None], 7, axis=1) + random.normal(0, 0.005, (300, 7, 3))
    body[:, (0, 2, 4), 2] += lifted_m[:, None]
    body[:, (1, 3, 5), 2] += 0.12 - lifted_m[:, None]
    body[:, 4:6, 2] += 0.085
    body[:, 6, 2] += 1.6
    floor = _floor(Skeleton("feet", (*feet, "nose")), body)
    new_from_old = floor.new_from_old(lab.rig)
    assert (new_from_old @ np.zeros(3))[2] == pytest.approx(0, abs=0.02)
    # a network without heels and toes: a share of the height above its ankles
    body = walker(STAMPS_S)
    ankles, nose = body[:, [BODY.index("left_ankle"), BODY.index("right_ankle")]], body[:, BODY.index("nose")]
    through_ankles = floor_from_feet(ankles.reshape(-1, 3), nose)
    below = through_ankles @ _floor(BODY, body).new_from_old(lab.rig).inverse()
    np.testing.assert_allclose(below.xyz, [0, 0, -0.039 * STATURE_M], atol=1e-6)

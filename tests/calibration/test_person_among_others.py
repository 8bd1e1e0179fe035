"""A rig from a person while another one walks about in the same views: one of them is taken in all cameras, or it is refused."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from synthetic_walk import BODY, STATURE_M, walker

from posefuse.calibration.clocks.person_tracks import person_tracks
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.several_people import ChosenPerson, choose_person, people_tracks
from posefuse.calibration.person.solve import PersonCalibration, calibrate_from_person
from posefuse.calibration.person.views import person_views
from posefuse.calibration.report import RefusedCalibration
from posefuse.core import Camera, Detections2D, Rig
from posefuse.pipeline.calibration import solve_person
from posefuse.pipeline.person_poses import PersonSeen

T_S = np.arange(72) / 6.0
LENGTH = KnownLength(stature_m=STATURE_M)


def walks() -> tuple[np.ndarray, np.ndarray]:
    """(T, 17, 3) of two people who cross each other's way."""
    return walker(T_S), walker(0.8 * T_S + 3.3, (0.5, 0.4), lap_rad_s=-0.8)


def watched(camera: Camera, people: Sequence[np.ndarray], seed: int) -> list[Detections2D]:
    """Everybody in a camera's frames, in an order that changes from frame to frame."""
    random, frames = np.random.default_rng(seed), []
    seen = np.stack([camera.project(xyz) for xyz in people], axis=1)
    seen = seen + random.normal(0, 1.0, seen.shape)
    for t_s, xy in zip(T_S, seen, strict=True):
        order = random.permutation(len(people))
        score = np.full((len(people), len(BODY)), 0.9)
        box = np.concatenate([xy.min(axis=1), xy.max(axis=1)], axis=-1)
        frames.append(
            Detections2D(
                camera=camera.name, t_ns=round(t_s * 1e9), skeleton=BODY, xy_img=xy[order], score=score, sigma_px=0 * score + 1,
                box_img=box[order],
            )
        )  # fmt: skip
    return frames


def all_watched(rig: Rig, who: Sequence[Sequence[int]]) -> dict[str, list[Detections2D]]:
    """Which of the two people each camera sees."""
    both = walks()
    return {
        camera.name: watched(camera, [both[p] for p in people], seed=c)
        for c, (camera, people) in enumerate(zip(rig, who, strict=True))
    }


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
    seen = all_watched(lab.rig, [(0, 1)] * 4)
    chosen = choose_person(seen, lab.rig.cameras)
    assert len(set(followed(lab.rig, chosen))) == 1


@pytest.mark.slow
def test_the_rig_from_one_of_two_people_is_as_good_as_from_one_alone(lab: Any) -> None:
    chosen = choose_person(all_watched(lab.rig, [(0, 1)] * 4), lab.rig.cameras)
    found = calibrated(lab.rig, chosen)
    millimetres, degrees = lab.errors(found.rig)
    assert millimetres.max() < 0.02 * 4500
    assert degrees.max() < 0.15
    assert "several people are in view of cam00, cam01, cam02, cam03" in " ".join(found.report.notes)


@pytest.mark.slow
def test_the_largest_person_of_each_camera_alone_would_be_refused(lab: Any) -> None:
    """Shows that the choice is needed: in this scene the largest person is not the same in all cameras."""
    seen = all_watched(lab.rig, [(0, 1)] * 4)
    largest = person_tracks(seen)
    with pytest.raises(RefusedCalibration):
        calibrate_from_person(person_views(largest), lab.rig.cameras, LENGTH)


def test_the_person_whom_all_cameras_see_is_taken(lab: Any) -> None:
    for everywhere in (0, 1):
        who = [(0, 1), (0, 1), (everywhere,), (0, 1)]
        assert followed(lab.rig, choose_person(all_watched(lab.rig, who), lab.rig.cameras)) == [everywhere] * 4


@pytest.mark.slow
def test_where_no_person_is_in_all_cameras_it_is_refused_by_name(lab: Any) -> None:
    seen = all_watched(lab.rig, [(0, 1), (0,), (0, 1), (1,)])
    with pytest.raises(RefusedCalibration, match="one person in view"):
        calibrated(lab.rig, choose_person(seen, lab.rig.cameras))


def test_one_person_alone_is_followed_as_before(lab: Any) -> None:
    seen = all_watched(lab.rig, [(0,)] * 4)
    chosen = choose_person(seen, lab.rig.cameras)
    assert chosen.several_in == ()
    for one, other in zip(chosen.tracks, person_tracks(seen), strict=True):
        np.testing.assert_array_equal(one.xy_img, other.xy_img)


def test_people_are_followed_through_frames_without_them(lab: Any) -> None:
    camera = lab.rig.cameras[0]
    frames = watched(camera, walks(), seed=5)
    gone = [frame.people(np.zeros(0, np.int64)) if 30 <= i < 34 else frame for i, frame in enumerate(frames)]
    tracks = people_tracks(camera.name, gone)
    assert len(tracks) == 2
    for track in tracks:
        assert np.isnan(track.xy_img[30:34]).all()
        there = np.isfinite(track.xy_img).all(axis=(1, 2))
        away = [np.linalg.norm(track.xy_img - camera.project(xyz), axis=-1)[there] for xyz in walks()]
        assert min(np.median(one, axis=1).max() for one in away) < 4

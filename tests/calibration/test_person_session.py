"""A person as users calibrate from them: through the public function, in any order of the cameras, and with cameras that move."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from built import turned
from studies import write_openpose
from synthetic_walk import BODY, STATURE_M, walker, watch_walker

import posefuse as pf
from posefuse.calibration.extrinsics.world import floor_from_feet
from posefuse.calibration.person.bundle import solve_person_bundle
from posefuse.calibration.person.checks import check_standing
from posefuse.calibration.person.solve import _floor
from posefuse.calibration.person.views import PersonViews
from posefuse.core import Rig, Skeleton
from posefuse.formats.rig import write_rig
from posefuse.pipeline.person_poses import timeline_of

RATE_HZ, SECONDS = 12.0, 20.0
T_S = np.arange(round(RATE_HZ * SECONDS)) / RATE_HZ


def views_of(rig: Rig, seed: int = 0) -> PersonViews:
    return watch_walker(rig, SECONDS, RATE_HZ, 1.5, seed, lap_rad_s=0.7)


def moved_at(rig: Rig, at_s: dict[int, float], degrees: float) -> PersonViews:
    views = views_of(rig)
    xy = views.xy_img.copy()
    for camera, at in at_s.items():
        late = at <= T_S
        xy[camera, late] = views_of(turned(rig, camera, np.deg2rad(degrees) * np.array([0, 0.8, 0.6]))).xy_img[camera, late]
    return replace(views, xy_img=xy)


def standing(rig: Rig, views: PersonViews) -> Any:
    return check_standing(solve_person_bundle(views, rig.cameras, 600))


@pytest.mark.parametrize("at_s", [10.0, 15.0])
def test_a_camera_that_turns_by_a_degree_is_named_with_the_time(lab: Any, at_s: float) -> None:
    check = standing(lab.rig, moved_at(lab.rig, {2: at_s}, 1.0))
    assert not check.passed
    found = re.fullmatch(r"cam02 was moved at about (\d+) s, its view by (\d\.\d) deg", check.detail)
    assert found is not None, check.detail
    assert float(found[1]) == pytest.approx(at_s, abs=1.5)
    assert float(found[2]) == pytest.approx(1.0, abs=0.3)


def test_cameras_that_stand_are_not_accused(lab: Any) -> None:
    assert standing(lab.rig, views_of(lab.rig)).passed


@pytest.mark.slow
def test_two_cameras_that_move_at_one_time_are_both_named(lab: Any) -> None:
    """In four cameras; an innocent one may be named with them, and two that move at different times may pass."""
    check = standing(lab.rig, moved_at(lab.rig, {0: 10.0, 2: 10.0}, 3.0))
    assert "cam00 was moved" in check.detail and "cam02 was moved" in check.detail


def written(folder: Path, rig: Rig, late_s: tuple[float, ...]) -> dict[str, Path]:
    """2D poses of each camera."""
    files, random = {camera.name: folder / camera.name for camera in rig}, np.random.default_rng(3)
    for camera, late in zip(rig, late_s, strict=True):
        xy = camera.project(walker(T_S - late, lap_rad_s=0.7))
        write_openpose(files[camera.name], dict(enumerate((xy + random.normal(0, 1, xy.shape))[:, None])))
    return files


@pytest.mark.slow
def test_the_order_of_the_cameras_changes_nothing(lab: Any, tmp_path: Path) -> None:
    rig = replace(lab.rig, cameras=lab.rig.cameras[:3])
    files, late_s = written(tmp_path, rig, (0.0, 0.1, -0.05)), {"cam00": 0.0, "cam01": 0.1, "cam02": -0.05}
    found = [
        pf.calibrate_person({name: files[name] for name in order}, intrinsics=rig, height_m=STATURE_M, rate_hz=RATE_HZ)
        for order in (("cam00", "cam01", "cam02"), ("cam02", "cam00", "cam01"))
    ]
    assert found[0].rig.names == found[1].rig.names == rig.names
    np.testing.assert_array_equal(found[0].rig.centres_world(), found[1].rig.centres_world())
    assert found[0].clock_settings == found[1].clock_settings != ""
    # another camera as the first by name: other numbers, and the same within what is stated
    other = {"cam00": "z", "cam01": "y", "cam02": "x"}
    renamed = replace(rig, cameras=tuple(replace(camera, name=other[camera.name]) for camera in rig))
    again = pf.calibrate_person(
        {other[name]: path for name, path in files.items()}, intrinsics=renamed, height_m=STATURE_M, rate_hz=RATE_HZ
    )
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
    class Recorded:
        def __init__(self, camera: str, seconds: float, rate_hz: float) -> None:
            self.camera, self._t_ns = camera, (np.arange(round(seconds * rate_hz)) / rate_hz * 1e9).astype(np.int64)

        def times_ns(self) -> np.ndarray:
            return self._t_ns

    def timeline(seconds: float, rate_hz: float, **more: float) -> Any:
        sources: list[Any] = [Recorded("a", seconds, rate_hz), Recorded("b", seconds, rate_hz)]
        return timeline_of(sources, **more)

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
    body = walker(T_S)
    ankles, nose = body[:, [BODY.index("left_ankle"), BODY.index("right_ankle")]], body[:, BODY.index("nose")]
    through_ankles = floor_from_feet(ankles.reshape(-1, 3), nose)
    below = through_ankles @ _floor(BODY, body).new_from_old(lab.rig).inverse()
    np.testing.assert_allclose(below.xyz, [0, 0, -0.039 * STATURE_M], atol=1e-6)

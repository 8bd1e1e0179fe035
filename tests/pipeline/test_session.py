"""A session folder is understood by convention, and what cannot be distinguished is an error that says what to do."""

import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from built import detections
from checks import refusal
from commands import oracle
from videos import remuxed

import posefuse as pf
from posefuse.core import CalibrationError, DetectionBatch, InputError, LookKind, Observations
from posefuse.core.skeleton import COCO17
from posefuse.formats.rig import write_rig
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.pipeline.opening import build_source, open_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.track import _check_people


@pytest.fixture
def session(tmp_path: Path, ring_rig) -> Path:
    write_rig(tmp_path / "rig.toml", ring_rig(3).renamed({"cam00": "cam_01", "cam01": "cam_02", "cam02": "cam_10"}))
    return tmp_path


def touch(folder: Path, names: Iterable[str]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize(
    "names",
    [
        ["cam_01.mp4", "cam_02.mp4", "cam_10.mp4"],
        ["Cam1.avi", "cam02.MP4", "cam10.mkv"],
        ["trial3_cam01.mp4", "trial3_cam02.mp4", "trial3_cam10.mp4"],
        ["1.mp4", "2.mp4", "10.mp4"],
    ],
)
@pytest.mark.parametrize("place", [".", "videos"])
def test_videos_find_their_cameras_whatever_the_spelling(session: Path, names: list[str], place: str) -> None:
    touch(session / place, names)
    found = find_session(session, TrackConfig())
    assert [(entry.camera, entry.path.name) for entry in found.inputs] == list(zip(found.rig.names, names, strict=True))
    assert {entry.kind for entry in found.inputs} == {"videos"}
    assert found.notes == ()


def test_images_and_pose_folders(session: Path) -> None:
    for name in ("cam_01", "cam_02", "cam_10"):
        touch(session / "images" / name, ["0001.jpg", "0002.jpg"])
        touch(session / "openpose_json" / f"{name}_json", ["a.0000.json"])
    assert {entry.kind for entry in find_session(session, TrackConfig()).inputs} == {"images"}
    poses = find_session(session, TrackConfig(input="pose2d"))
    assert [entry.path.name for entry in poses.inputs] == ["cam_01_json", "cam_02_json", "cam_10_json"]


def test_the_rate_of_images_is_asked_for_in_one_line(session: Path, recwarn: pytest.WarningsRecorder) -> None:
    for name in ("cam_01", "cam_02", "cam_10"):
        touch(session / "images" / name, ["0001.jpg", "0002.jpg"])
    with pytest.raises(InputError, match=r"images of cam_01, cam_02, cam_10 do not state their frame rate; add `rate_hz=HZ`"):
        open_session(find_session(session, TrackConfig()), TrackConfig())
    assert not recwarn.list


def test_a_calibrated_camera_without_data_is_left_aside_and_said(session: Path) -> None:
    touch(session, ["cam_01.mp4", "cam_10.mp4"])
    found = find_session(session, TrackConfig())
    assert found.rig.names == ("cam_01", "cam_10")
    assert found.notes == ("camera cam_02: calibrated, but no videos found; left aside",)


def test_the_config_names_skips_and_overrules(session: Path) -> None:
    touch(session, ["cam_01.mp4", "cam_02.mp4", "extra.mp4"])
    cameras = {"cam_10": CameraInput(video="extra.mp4", offset_s=0.25), "cam_02": CameraInput(skip=True)}
    found = find_session(session, TrackConfig(cameras=cameras))
    assert [(entry.camera, entry.path.name) for entry in found.inputs] == [("cam_01", "cam_01.mp4"), ("cam_10", "extra.mp4")]
    assert found.inputs[1].settings.offset_s == 0.25


def refused(session: Path, config: TrackConfig = TrackConfig()) -> str:  # noqa: B008 - a frozen value
    return refusal((InputError, CalibrationError), "", find_session, session, config)


def test_what_is_wrong_is_named(session: Path, tmp_path: Path) -> None:
    assert "no videos or images or pose2d found" in refused(session)
    touch(session, ["cam_01.mp4"])
    assert "at least 2 calibrated cameras, got 1" in refused(session)
    touch(session, ["cam_02.mp4", "a person.mp4"])
    message = refused(session)
    assert "a person.mp4" in message and "cam_01, cam_02, cam_10" in message and "[cameras.cam_01]" in message
    (session / "a person.mp4").unlink()
    touch(session, ["trial_cam_02.mp4"])
    assert "second one for camera cam_02" in refused(session)
    assert "no camera cam_99" in refused(session, TrackConfig(cameras={"cam_99": CameraInput(video="x.mp4")}))
    assert "no such file" in refused(session, TrackConfig(cameras={"cam_01": CameraInput(video="x.mp4")}))
    both = TrackConfig(cameras={"cam_01": CameraInput(video="cam_01.mp4", images="y")})
    assert "one of video, images, pose2d, got 2" in refused(session, both)
    assert "no such calibration file" in refused(session, TrackConfig(rig="none.toml"))
    assert "no such session folder" in refused(tmp_path / "nowhere")
    (session / "rig.toml").unlink()
    assert "no calibration file" in refused(session)


def detections_of(found: dict[str, int], depth: bool) -> Observations:
    """One time step in which each camera found so many people."""
    places = {name: np.full((count, len(COCO17), 2), 100.0) for name, count in found.items()}
    seen = tuple(detections(name, xy, depth_m=np.ones_like(xy) if depth else None) for name, xy in places.items())
    batch = DetectionBatch(step=0, t_ns=0, kind=LookKind.SEARCH, detections=seen)
    return Observations.from_batches(COCO17, tuple(found), [batch], [[np.arange(n) for n in found.values()]])


@pytest.mark.parametrize(("depth", "seeing", "enough"), [(False, 2, True), (False, 1, False), (True, 1, True), (True, 0, False)])
def test_a_person_in_too_few_cameras_is_refused_with_their_number(depth: bool, seeing: int, enough: bool, recwarn) -> None:
    found = {f"cam{c}": int(c < seeing) for c in range(3)}
    if enough:
        _check_people(detections_of(found, depth))
    else:
        with pytest.raises(InputError, match=rf"a person was found in {seeing} of 3 cameras.*no person in: .*cam2"):
            _check_people(detections_of(found, depth))
    assert [str(one.message).split(":")[0] for one in recwarn] == [f"camera cam{c}" for c in range(seeing, 3)]


@pytest.mark.parametrize(("cameras", "own_threads"), [(1, True), (4, True), (5, False), (9, False)])
def test_videos_have_decoding_threads_of_their_own_only_where_cameras_leave_cores_idle(
    demo_session: Path, monkeypatch: pytest.MonkeyPatch, cameras: int, own_threads: bool
) -> None:
    monkeypatch.setattr("posefuse.pipeline.opening.usable_cores", lambda: 5)
    entry = find_session(demo_session, TrackConfig()).inputs[0]
    assert build_source(entry, TrackConfig(), cameras)._config.threads == own_threads


# --- how a result was made is written in it, with the date that the camera wrote into its video


@pytest.mark.parametrize("stated", ["2026-03-01T09:30:00Z", None])
def test_the_date_of_the_first_video_is_that_of_the_recording(demo_session: Path, tmp_path: Path, stated: str | None) -> None:
    session = Path(shutil.copytree(demo_session, tmp_path / "session"))
    if stated is not None:
        remuxed(demo_session / "videos" / "cam00.mp4", session / "videos" / "cam00.mp4", stated=stated)
    about = pf.track(session, end_s=0.2, settings=oracle()).provenance
    assert about.get("recorded") == stated
    assert (about["session"], about["inputs"]["cam00"]) == ("session", "cam00.mp4")
    assert about["config"]["end_s"] == 0.2

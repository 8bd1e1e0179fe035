"""Corrections by hand: what a second solve leaves out, whom it keeps, and where that is written down."""

import dataclasses
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built import detections
from checks import assert_same, refusal
from commands import error

import posefuse as pf
from posefuse.api.recording import recording_of
from posefuse.cli.main import main
from posefuse.core import ConfigError, DetectionBatch, InputError, LookKind, Observations, Recording, Rig, SourceError
from posefuse.core.observations import NOT_KEPT
from posefuse.core.skeleton import COCO17
from posefuse.formats.recording import read_recording, write_recording
from posefuse.foundation.parsing import plain
from posefuse.pipeline.config import TrackConfig, changed_config
from posefuse.pipeline.edits import Edits, Exclusion, used_frames
from posefuse.pipeline.solve import edits_of, solve, solve_again

T, K, PERIOD_NS, CAMERAS = 45, len(COCO17), 33_333_333, 5
# the stretch in which camera 2 is wrong
FROM_S, TO_S = 0.5, 0.9
# so little that consensus does not leave the camera out by itself
OFF_PX = 5.0
BODY = np.random.default_rng(4).normal(size=(K, 3)) * [0.2, 0.2, 0.4] + [-0.5, 0.3, 1.0]
APART = np.array([0.9, 0.8, 0.0])
BLOCKED = Exclusion(camera="cam02", start_s=FROM_S, end_s=TO_S)


def people_at(t_ns: int) -> np.ndarray:
    """(2, K, 3) two people who walk next to each other."""
    return BODY + np.array([1.2, -0.5, 0.0]) * t_ns * 1e-9 + np.arange(2)[:, None, None] * APART


def noisy_log(rig: Rig) -> Observations:
    """Two people in five cameras; camera 2 is off to one side for a while."""
    rng, batches = np.random.default_rng(7), []
    for i in range(T):
        t_ns, found = i * PERIOD_NS, []
        for camera in rig:
            bad = camera.name == BLOCKED.camera and FROM_S <= t_ns / 1e9 < TO_S
            xy = camera.project(people_at(t_ns)) + rng.normal(0, 1.0, (2, K, 2)) + bad * np.array([OFF_PX, 0.0])
            found.append(detections(camera.name, xy, t_ns, score=1.0, sigma_px=1.5))
        batches.append(DetectionBatch(step=i, t_ns=t_ns, kind=LookKind.SEARCH, detections=tuple(found)))
    return Observations.from_batches(COCO17, rig.names, batches)


CONFIG = changed_config(TrackConfig(), {"associate.max_people": 2})


@pytest.fixture(scope="module")
def recording(ring_rig: Callable[..., Rig]) -> Recording:
    rig = ring_rig(CAMERAS)
    about = {"session": "walk", "config": plain(dataclasses.asdict(CONFIG))}
    return solve(noisy_log(rig), rig, about)


def assert_same_poses(one: Recording, other: Recording) -> None:
    assert_same(one.poses, other.poses)


def inside(recording: Recording) -> np.ndarray:
    t_s = recording.poses.t_ns / 1e9
    return (t_s >= FROM_S) & (t_s < TO_S)


def error_mm(recording: Recording, steps: np.ndarray) -> float:
    true = np.stack([people_at(t_ns) for t_ns in recording.poses.t_ns.tolist()])
    off = np.linalg.norm(recording.poses.xyz_world[:, :, None] - true[:, None], axis=-1).mean(axis=-1)
    return float(1000 * np.nanmedian(off[steps].min(axis=-1)))


def test_without_edits_every_bit_stays(recording: Recording) -> None:
    again = solve_again(recording)
    assert_same_poses(again, recording)
    assert again.provenance == recording.provenance
    np.testing.assert_array_equal(again.observations.person_id, recording.observations.person_id)


def test_a_part_is_that_part_and_can_be_solved_again(recording: Recording) -> None:
    part = solve_again(recording, changed_config(CONFIG, {"start_s": 0.3, "end_s": 1.0}))
    # 0.3 s is 3 ns after its time step, which is the nearest one all the same
    np.testing.assert_array_equal(part.poses.t_ns, recording.poses.t_ns[9:31])
    assert error_mm(part, np.ones(22, np.bool_)) < 2 * error_mm(recording, np.arange(T) < T)
    assert_same_poses(solve_again(part), part)
    with pytest.raises(SourceError, match=r"nothing recorded from 7 s; the recording runs from 0\.000 to 1\.467"):
        solve_again(recording, changed_config(CONFIG, {"start_s": 7.0}))


def test_how_well_the_cameras_fit_is_of_the_new_solve(recording: Recording) -> None:
    tracked = replace(recording, provenance={**recording.provenance, "camera_fits": {}})
    fits = solve_again(tracked, edits=Edits(exclusions=(BLOCKED,))).provenance["camera_fits"]
    assert fits["cam02"]["left_out"] == pytest.approx(inside(recording).mean(), abs=0.1) and fits["cam00"]["left_out"] == 0


def test_warnings_are_of_what_is_used(recording: Recording) -> None:
    log, unread = recording.observations, "camera cam03: 20% of its frames cannot be read (9 of 45)"
    short = log.only((log.frame_camera != 3) | (log.frame_t_ns < 1.2e9))
    about = {
        "camera_fits": {},
        "moved_cameras": [{"camera": "cam01", "t_ns": 700_000_000, "warning": "the background of cam01 turns"}],
        "rig_warnings": ["the background of cam01 turns", "at 0.9 s: what another rig had"],
        "incomplete_cameras": [unread],
    }
    tracked = replace(recording, observations=short, provenance={**recording.provenance, **about})

    def left(*exclusions: Exclusion) -> list[list[str]]:
        made = solve_again(tracked, edits=Edits(exclusions=exclusions)).provenance
        return [made["rig_warnings"], made["incomplete_cameras"]]

    assert left() == [["the background of cam01 turns"], [unread]]
    assert left(Exclusion(camera="cam01", start_s=0.7, end_s=9)) == [[], [unread]]
    assert left(Exclusion(camera="cam03", start_s=-1, end_s=9)) == [["the background of cam01 turns"], []]
    part = solve_again(tracked, changed_config(CONFIG, {"start_s": 0.8, "end_s": 1.1})).provenance
    assert (part["rig_warnings"], part["incomplete_cameras"]) == ([], [])


@pytest.mark.parametrize("change", [{"rate_hz": 60.0}, {"cameras.cam02.offset_s": 0.1}, {"keypoints": "body_25b"}])
def test_settings_that_the_detections_were_made_with_are_refused(recording: Recording, change: dict[str, object]) -> None:
    (name,) = change
    line = f"{name.split('.')[0]}: the detections were made with another value; for this one, track the session again"
    refusal(ConfigError, line, solve_again, recording, changed_config(CONFIG, change))


@pytest.mark.parametrize(
    "exclusions",
    [(BLOCKED,), (BLOCKED, Exclusion(camera="cam04", start_s=0.7, end_s=1.2)), (Exclusion(start_s=0.6, end_s=0.8),)],
    ids=["a camera", "two that overlap", "all cameras"],
)
def test_excluding_is_solving_without_these_observations(recording: Recording, exclusions: tuple[Exclusion, ...]) -> None:
    log, rig = recording.observations, recording.rig
    used = used_frames(log, exclusions)
    assert 0 < (~used).sum() < len(used)
    without = solve(log.only(used), rig, recording.provenance)
    edited = solve_again(recording, edits=Edits(exclusions=exclusions))
    assert_same_poses(edited, without)
    rows = used[log.detection_frame]
    np.testing.assert_array_equal(edited.observations.person_id[rows], without.observations.person_id)
    assert (edited.observations.person_id[~rows] == NOT_KEPT).all()
    assert not np.array_equal(edited.poses.xyz_world, recording.poses.xyz_world)


def test_nothing_is_thrown_away_so_that_edits_can_be_taken_back(recording: Recording, tmp_path: Path) -> None:
    edited = solve_again(recording, edits=Edits(exclusions=(BLOCKED,), person=1, names=("Ada", "Ben")))
    assert edited.person_names == ("Ben",)
    write_recording(tmp_path, edited)
    kept = read_recording(tmp_path)
    assert_same_poses(solve_again(kept), edited)
    assert edits_of(kept.provenance).person == 1
    back = solve_again(kept, changed_config(CONFIG, {}), edits=Edits())
    assert_same_poses(back, recording)
    assert back.provenance == recording.provenance


@pytest.mark.parametrize("person", [0, 1])
def test_the_person_kept_is_that_of_the_earlier_result(recording: Recording, person: int) -> None:
    edited = solve_again(recording, edits=Edits(exclusions=(BLOCKED,), person=person))
    assert edited.poses.person_id.tolist() == [person]
    both = recording.poses
    earlier = both.xyz_world[:, both.person_id.tolist().index(person)]
    away_m = np.nanmedian(np.linalg.norm(edited.poses.xyz_world[:, 0] - earlier, axis=-1))
    assert away_m < 0.1 * np.linalg.norm(APART)
    assert set(np.unique(edited.observations.person_id)) == {NOT_KEPT, person}


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        (Edits(exclusions=(Exclusion(camera="cam9", start_s=0, end_s=1),)), "no camera 'cam9'; there are: cam00"),
        (Edits(exclusions=(Exclusion(start_s=1, end_s=1),)), "an end after the start"),
        (Edits(person=5), "no person 5; there are: 0, 1"),
        (Edits(exclusions=(Exclusion(start_s=-1, end_s=99),), person=1), "person"),
    ],
)
def test_edits_about_what_is_not_there_are_refused(recording: Recording, edits: Edits, words: str) -> None:
    refusal(InputError, words, solve_again, recording, edits=edits)


def saved(recording: Recording, folder: Path) -> Path:
    recording_of(recording).save(folder)
    return folder


@pytest.mark.parametrize("person", [None, 0])
def test_exclusions_that_leave_no_one_are_named(recording: Recording, person: int | None) -> None:
    """The line was that no person could be followed, as of a bad calibration."""
    exclusions = (Exclusion(start_s=0.1, end_s=9.0), Exclusion(camera="cam02", start_s=-1.0, end_s=0.5))
    words = "left out are all cameras from 0.1 to 9 s, cam02 from -1 to 0.5 s; exclude less"
    refusal(InputError, words, solve_again, recording, edits=Edits(exclusions=exclusions, person=person))


def test_an_exclusion_in_which_there_is_no_frame_is_refused(recording, tmp_path, capsys) -> None:
    result = saved(recording, tmp_path / "result")
    shown = error(capsys, "solve", result, "--exclude", "50-60", "--out", tmp_path / "out")
    assert "no frame of any camera from 50 to 60 s; the recording is from 0.00 to 1.47 s" in shown
    # one of the whole of it may lie outside the part that is solved
    pf.solve(result, tmp_path / "part", edits=Edits(exclusions=(BLOCKED,)), settings={"end_s": 0.4, "outputs": ("csv",)})


def test_from_the_shell_options_take_the_place_of_earlier_edits(recording, tmp_path) -> None:
    result, out = saved(solve_again(recording, edits=Edits(exclusions=(BLOCKED,))), tmp_path / "result"), tmp_path / "edited"
    line = ["solve", str(result), "--exclude", "cam04:0.7-1.2", "--keep-person", "1", "--outputs", "csv", "--out", str(out)]
    assert main(line) == 0
    exclusions = (Exclusion(camera="cam04", start_s=0.7, end_s=1.2),)
    assert_same_poses(read_recording(out), solve_again(recording, edits=Edits(exclusions=exclusions, person=1)))
    assert main([*line[:2], "--outputs", "csv", "--out", str(tmp_path / "same")]) == 0
    assert_same_poses(read_recording(tmp_path / "same"), read_recording(result))
    assert main(line) == 1  # a result that is there is never replaced in silence


@pytest.mark.parametrize(
    "words", [["--exclude", "cam02"], ["--keep-person", "-1"], ["--exclude", "cam02:1.5"]], ids=["no time", "no id", "one time"]
)
def test_options_that_cannot_be_are_one_line(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert words[0] in error(capsys, "track", tmp_path, *words, "--out", tmp_path / "out")


def test_a_session_is_tracked_before_it_is_edited(demo_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = error(capsys, "solve", demo_session, "--exclude", "cam00:0-1", "--out", tmp_path / "out")
    assert "not a posefuse result" in shown

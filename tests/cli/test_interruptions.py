"""Finished work survives: whatever ends `posefuse track`, --resume gives the bytes of an uninterrupted run."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from subprocess import CompletedProcess

import numpy as np
import pytest
from checks import assert_same
from running import Running
from studies import write_openpose

from posefuse.core import SE3, Rig
from posefuse.core.skeleton import COCO17
from posefuse.formats.detection_log import LOG_FILE, read_log
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import read_rig, write_rig
from posefuse.foundation.output_folder import MARK_FILE, FolderMark, find_unfinished, write_mark
from posefuse.pipeline.solve import solve_again

STEPS, K = 40, len(COCO17)
AT_MOST_S = 300
RUN, STORE, OUTPUTS = "posefuse.pipeline.track", "posefuse.pipeline.result_folder", "posefuse.pipeline.writing"
DETECTING = [STORE, "DetectionStore.append", 25]
STORING = ["posefuse.formats.detection_log", "_write_all", 25]
SOLVING = [RUN, "solve_followed", 1]
WRITING = [OUTPUTS, "write_recording", 1]
EXPORTING = [OUTPUTS, "write_each", 1]
FINISHING = ["posefuse.foundation.output_folder", "_finish", 1]


@pytest.fixture(scope="module")
def session(ring_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A person who walks, is gone for a while and comes back, as OpenPose JSON of three cameras."""
    folder, rig, rng = tmp_path_factory.mktemp("interrupted") / "session", ring_rig(3), np.random.default_rng(3)
    body = rng.normal(size=(K, 3)) * [0.2, 0.2, 0.4] + [-0.5, 0.3, 1.0]
    for camera in rig:
        seen = [camera.project(body + [0.03 * i, 0, 0])[None] + rng.normal(0, 1, (K, 2)) for i in range(STEPS)]
        frames = {i: xy[:0] if 12 <= i < 16 else xy for i, xy in enumerate(seen)}
        write_openpose(folder / "openpose_json" / f"{camera.name}_json", frames)
    write_rig(folder / "rig.toml", rig)
    return folder


class Tracker:
    """Runs of `posefuse track`, each a process of its own that ends where it is interrupted; the first is not interrupted.

    A fork of that first one, which has its modules and kernels loaded, costs a third of a process from the beginning.
    """

    def __init__(self, session: Path, folder: Path) -> None:
        self._folder, self.session = folder, session
        script = Path(__file__).with_name("interrupting.py")
        self._running = Running([sys.executable, str(script), *_arguments(session, folder / "whole")], stdin=subprocess.PIPE)

    def __enter__(self) -> "Tracker":
        self._running.__enter__()
        assert self._status() == 0
        self.whole = results(self._folder / "whole")
        return self

    def __exit__(self, *error: object) -> None:
        self._running.__exit__(*error)

    def __call__(self, out: Path, *options: str, at: tuple[list, ...] = (), session: Path | None = None) -> CompletedProcess[str]:
        arguments = [*_arguments(session or self.session, out), *options]
        said = [self._folder / "stdout", self._folder / "stderr"]
        for path in said:
            path.unlink(missing_ok=True)
        asked = json.dumps([at, arguments, *map(str, said), AT_MOST_S])
        self._running.process.stdin.write(asked + "\n")
        self._running.process.stdin.flush()
        return CompletedProcess(arguments, self._status(), *(path.read_text() for path in said))

    def _status(self) -> int:
        return int(self._running.out.wait_for(r"^-?\d+$", AT_MOST_S)[0])


def _arguments(session: Path, out: Path) -> list[str]:
    return ["track", str(session), "--out", str(out), "--outputs", "trc,csv", "--rate", "30"]


def results(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != MARK_FILE}


@pytest.fixture(scope="module")
def track(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tracker]:
    with Tracker(session, tmp_path_factory.mktemp("tracker")) as tracker:
        yield tracker


def check_completed(track: Tracker, out: Path, how: str = "--resume") -> None:
    done = track(out, how)
    assert done.returncode == 0, done.stderr
    assert results(out) == track.whole
    assert not find_unfinished(out)


def test_a_stored_result_solves_again_to_the_last_bit(track: Tracker, tmp_path: Path) -> None:
    for name, content in track.whole.items():
        (tmp_path / name).write_bytes(content)
    recording = read_recording(tmp_path)
    again = solve_again(recording)
    recorded, exported = {"observations.npz", "recording.json", "recording.npz", "rig.toml"}, {"pose.trc", "pose.csv"}
    assert set(track.whole) == recorded | exported
    assert_same((again.observations, again.poses), (recording.observations, recording.poses))
    assert (recording.observations.frame_look > 0).any(), "searches are part of what is replayed"


@pytest.mark.parametrize(
    "points",
    [
        pytest.param([[*DETECTING, "SIGKILL"]], id="killed while detecting"),
        pytest.param([[*SOLVING, "SIGTERM"]], id="terminated while solving", marks=pytest.mark.slow),
        pytest.param([[*DETECTING, "SIGINT"]], id="Ctrl-C while detecting"),
        pytest.param([[*DETECTING, "SIGTERM"]], id="terminated while detecting", marks=pytest.mark.slow),
        pytest.param([[*STORING, "full"]], id="disk full while detecting", marks=pytest.mark.slow),
        pytest.param([[*SOLVING, "SIGKILL"]], id="killed while solving", marks=pytest.mark.slow),
        pytest.param([[*WRITING, "SIGINT"]], id="Ctrl-C while writing", marks=pytest.mark.slow),
        pytest.param([[*WRITING, "full"]], id="disk full while writing", marks=pytest.mark.slow),
        pytest.param([[*EXPORTING, "SIGTERM"]], id="terminated while exporting", marks=pytest.mark.slow),
        pytest.param([[*EXPORTING, "SIGKILL"]], id="killed while exporting", marks=pytest.mark.slow),
        pytest.param([[*FINISHING, "SIGKILL"]], id="killed when all is written"),
    ],
)
def test_detections_are_kept_and_resume_gives_the_same_bytes(track: Tracker, tmp_path: Path, points: list[list]) -> None:
    out = tmp_path / "result"
    ended = track(out, at=tuple(points))
    assert ended.returncode != 0
    assert not out.exists()
    [left] = find_unfinished(out)
    assert (left / LOG_FILE).stat().st_size > 0
    if "SIGKILL" not in str(points):
        assert "with --resume continues" in ended.stderr
        assert ended.returncode == (1 if "full" in str(points) else 143 if "SIGTERM" in str(points) else 130)
    if "full" in str(points):
        assert "No space left on device" in ended.stderr.splitlines()[-1] and "Traceback" not in ended.stderr
    refused = track(out)
    assert refused.returncode == 1
    said = "an earlier run was interrupted; --resume continues it, --force starts from the beginning"
    assert refused.stderr.strip().endswith(said)
    check_completed(track, out)


def test_a_run_that_was_to_replace_a_result_is_continued(track: Tracker, tmp_path: Path) -> None:
    """--resume was refused for the result that the interrupted run was asked to replace, and --force dropped its detections."""
    out = tmp_path / "result"
    for name, content in track.whole.items():
        out.mkdir(exist_ok=True)
        (out / name).write_bytes(content)
    write_mark(out, FolderMark(command="track"))
    ended = track(out, "--force", at=([*DETECTING, "SIGINT"],))
    assert ended.returncode == 130 and results(out) == track.whole
    check_completed(track, out)
    [aside] = tmp_path.glob("result.replaced-*")
    assert results(aside) == track.whole


@pytest.mark.slow
def test_a_run_that_is_interrupted_repeatedly_can_be_completed(track: Tracker, tmp_path: Path) -> None:
    out = tmp_path / "result"
    for options in ((), ("--resume",)):
        assert track(out, *options, at=([*STORING[:2], 10, "SIGKILL"],)).returncode == -signal.SIGKILL
    [left] = find_unfinished(out)
    assert 10 < len({batch.step for batch in read_log(left / LOG_FILE).batches}) < STEPS
    check_completed(track, out)


def test_frames_whose_detections_never_reached_the_disk_are_detected_again(track: Tracker, tmp_path: Path) -> None:
    out = tmp_path / "result"
    track(out, at=([*DETECTING, "SIGKILL"],))
    [left] = find_unfinished(out)
    log = left / LOG_FILE
    log.write_bytes(log.read_bytes()[:-7] + bytes(3))
    check_completed(track, out)


def test_resume_starts_what_was_ended_before_its_first_detection(track: Tracker, tmp_path: Path) -> None:
    """What ends a program and starts it again does not know how far it was."""
    out = tmp_path / "result"
    track(out, at=([RUN, "open_session", 1, "SIGKILL"],))
    assert not out.exists()
    done = track(out, "--resume")
    assert (done.returncode, results(out)) == (0, track.whole), done.stderr
    assert "nothing to resume: starts from the beginning" in done.stderr
    again = track(out, "--resume")
    assert again.returncode == 1
    assert "nothing to resume" not in again.stderr


def test_interrupted_work_is_found_after_its_parent_folder_was_renamed(track: Tracker, tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    track(tmp_path / "before" / "result", at=([*DETECTING, "SIGKILL"],))
    (tmp_path / "before").rename(tmp_path / "after")
    check_completed(track, tmp_path / "after" / "result")


def test_of_a_calibration_that_fits_no_pair_of_cameras_the_detections_are_kept(track: Tracker, tmp_path: Path) -> None:
    """Each camera sees the person; no two see them in one place."""
    own = Path(shutil.copytree(track.session, tmp_path / "session"))
    rig = read_rig(own / "rig.toml")
    tilts = [SE3.from_rotvec([0.3 * c - 0.3, 0, 0], np.zeros(3)) for c in range(len(rig))]
    cameras = [replace(one, cam_from_world=tilt @ one.cam_from_world) for one, tilt in zip(rig, tilts, strict=True)]
    write_rig(own / "rig.toml", replace(rig, cameras=tuple(cameras)))
    done = track(tmp_path / "result", session=own)
    assert done.returncode == 1
    said = r"a person was found in \d+ frames of cam00, .* but no two agree: is the calibration the one of these videos\?$"
    assert re.search(said, done.stderr.splitlines()[-1]), done.stderr
    assert "no person found" not in done.stderr and "the detections made so far are kept" in done.stderr
    [left] = find_unfinished(tmp_path / "result")
    assert read_log(left / LOG_FILE).batches


@pytest.mark.slow
def test_force_starts_from_the_beginning(track: Tracker, tmp_path: Path) -> None:
    out = tmp_path / "result"
    track(out, at=([*DETECTING, "SIGKILL"],))
    check_completed(track, out, "--force")


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (("--set", "associate.max_people=2"), "setting associate.max_people"),
        pytest.param(("--end", "1.0"), "setting end_s", marks=pytest.mark.slow),
        pytest.param("rig", "rig", marks=pytest.mark.slow),
        ("data", "data of camera cam01"),
    ],
)
def test_resume_with_other_inputs_or_settings_is_refused_by_name(
    track: Tracker, tmp_path: Path, change: tuple[str, ...] | str, named: str
) -> None:
    out, own = tmp_path / "result", Path(shutil.copytree(track.session, tmp_path / "session"))
    assert track(out, at=([*DETECTING, "SIGKILL"],), session=own).returncode == -signal.SIGKILL
    if change == "rig":
        write_rig(own / "rig.toml", read_rig(own / "rig.toml").moved(SE3(np.array([1.0, 0, 0, 0]), np.array([0, 0, 1e-6]))))
    if change == "data":
        with next((own / "openpose_json" / "cam01_json").iterdir()).open("a") as file:
            file.write(" ")
    done = track(out, "--resume", *(change if isinstance(change, tuple) else ()), session=own)
    assert done.returncode == 1
    assert f"--resume: {named} has changed since the detections were made" in done.stderr.splitlines()[-1]
    assert "more changed" not in done.stderr
    [left] = find_unfinished(out)
    assert read_log(left / LOG_FILE).batches


def test_a_failed_output_is_named_and_the_others_are_written(track: Tracker, tmp_path: Path) -> None:
    for what, reason in (("full", "No space left on device"), ("bug", "ValueError: not thought of")):
        out = tmp_path / what
        done = track(out, "--json", at=(["posefuse.outputs.data_files", "write_trc", 1, what],))
        assert done.returncode == 1, done.stderr
        assert f"output trc: not written ({reason})" in done.stderr
        assert json.loads(done.stdout)["failed"] == {"trc": reason}
        assert results(out) == {name: content for name, content in track.whole.items() if name != "pose.trc"}


def test_space_is_asked_for_the_people_there_are(track: Tracker, small_disk: Callable[[int], Path]) -> None:
    """As many as may be followed would take some 20 MB; the one who is there takes less than one."""
    done = track(small_disk(8) / "result", "--set", "associate.max_people=64")
    assert done.returncode == 0, done.stderr


def test_a_full_disk_is_reported_before_the_work_or_loses_no_detection(track: Tracker, small_disk: Callable[[int], Path]) -> None:
    disk = small_disk(8)
    out, filler = disk / "result", disk / "filler"
    free = shutil.disk_usage(disk).free
    filler.write_bytes(bytes(free - 40_000))
    refused = track(out)
    assert refused.returncode == 1
    assert "MB will be written" in refused.stderr.splitlines()[-1]
    assert [path.name for path in disk.iterdir()] == ["filler"]
    filler.unlink()
    ended = track(out, at=([*DETECTING[:2], 20, "SIGKILL"],))
    assert ended.returncode == -signal.SIGKILL
    filler.write_bytes(bytes(shutil.disk_usage(disk).free - 4096))
    full = track(out, "--resume")
    assert full.returncode == 1
    filler.unlink()
    check_completed(track, out)

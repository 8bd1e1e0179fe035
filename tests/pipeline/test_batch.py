"""Many trials: every session is found and done once, a failure stays one trial's, and what is complete is never lost."""

import csv
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
from checks import refusal
from commands import as_options, error
from studies import FRAMES, SETTINGS, write_session

import posefuse as pf
from posefuse.cli.terminal import in_options
from posefuse.core import InputError, Rig, silent
from posefuse.formats.rig import write_rig
from posefuse.foundation.channel import Channel
from posefuse.foundation.worker import Worker
from posefuse.pipeline.batch import find_trials, processes, run_study, tasks
from posefuse.pipeline.batch import study as study_module
from posefuse.pipeline.batch.processes import outcomes_here, run_trial
from posefuse.pipeline.batch.tasks import Outcome, Task, run_task
from posefuse.pipeline.config import read_config
from posefuse.pipeline.result_folder import ResultFolder, unfinished_work
from posefuse.pipeline.track import others_line


@pytest.fixture
def folder(ring_rig: Callable[..., Rig], tmp_path: Path) -> Path:
    """Two participants; the first has one calibration for both trials, and a trial of the second is broken."""
    rig, study = ring_rig(3), tmp_path / "study"
    for name in ("P01/fast", "P01/slow", "P02/slow"):
        write_session(study / name, rig)
    write_rig(study / "P01" / "rig.toml", rig)
    write_rig(study / "P02" / "slow" / "rig.toml", rig)
    broken = study / "P02" / "broken" / "pose2d" / "cam0"
    broken.mkdir(parents=True)
    (broken / "cam0_000000_keypoints.json").write_text("{")
    (study / ".hidden" / "videos").mkdir(parents=True)
    (study / "notes.txt").write_text("mine")
    return study


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Trials run in this process; their names in order."""
    done: list[str] = []

    def run(tasks: Sequence[Task], jobs: int | None, scheduler: str | None) -> Iterator[Outcome]:
        for task in tasks:
            done.append(task.trial.name)
            yield run_task(task)

    monkeypatch.setattr(study_module, "_run", run)
    return done


def first_task(folder: Path, out: Path) -> Task:
    trial = find_trials(folder)[0]
    return Task(trial=trial, out=out / trial.name, settings={"outputs": ("trc",), **SETTINGS}, report=False)


def run(folder: Path, out: Path, **options: object) -> study_module.Study:
    return run_study(folder, out, **{"formats": ("trc",), "settings": SETTINGS, "report": False, **options})


def test_sessions_are_found_with_the_nearest_calibration(folder: Path) -> None:
    trials = find_trials(folder)
    assert [(trial.participant, trial.label) for trial in trials] == [
        ("P01", "fast"), ("P01", "slow"), ("P02", "broken"), ("P02", "slow")
    ]  # fmt: skip
    assert [trial.rig and trial.rig.parent.name for trial in trials] == ["P01", "P01", None, None]


@pytest.mark.parametrize(("name", "problem"), [("P01/slow", "is a session itself"), (".hidden", "no session"), ("no", "no such")])
def test_a_folder_that_is_no_study_is_refused(folder: Path, name: str, problem: str) -> None:
    refusal(InputError, problem, find_trials, folder / name)
    refusal(InputError, "`jobs=2`: the workers of .* leave it out", run, folder, folder, jobs=2, scheduler="tcp://127.0.0.1:9")


def test_results_next_to_sessions_are_no_sessions(folder: Path, here: list[str], tmp_path: Path) -> None:
    """A result holds a video of what was found, `overlay.mp4`: it failed as a trial, and by itself was called a session."""
    run(folder, tmp_path / "results")
    result = (tmp_path / "results" / "P01" / "fast").rename(folder / "P01" / "fast-result")
    (result / "overlay.mp4").touch()
    names = [trial.name for trial in find_trials(folder)]
    assert names == ["P01/fast", "P01/slow", "P02/broken", "P02/slow"]
    refusal(InputError, "no session found below it", find_trials, result)


@pytest.mark.parametrize("own_rig", [True, False])
def test_a_session_whose_videos_cannot_be_read_is_a_failed_trial(own_rig: bool, folder, here, tmp_path) -> None:
    """A folder with a calibration or a folder of videos in it was passed over in silence where no video had a known suffix."""
    (folder / "P01" / "lost" / "videos").mkdir(parents=True)
    (folder / "P01" / "lost" / "videos" / "cam0.braw").write_bytes(b"frames")
    if own_rig:
        (folder / "P01" / "rig.toml").rename(folder / "P01" / "lost" / "rig.toml")
    # where calibrations lie is no session
    (folder / "P01" / "calibration").mkdir()
    write_rig(folder / "P01" / "calibration" / "rig.toml", pf.read_rig(folder / "P02" / "slow" / "rig.toml"))
    study = run(folder, tmp_path / "out")
    assert list(study.failed) == ["P01/lost", "P02/broken"]
    assert re.search(r"no videos .*looked in .*videos/", study.failed["P01/lost"])


def test_the_table_names_files_as_they_lie_in_the_study(folder: Path, here: list[str], tmp_path: Path) -> None:
    """Reasons and warnings had the path of the study on this machine, which is another one once it is moved."""
    (folder / "P02" / "slow" / "rig.toml").write_text("[")
    run(folder, tmp_path / "out")
    shown = (tmp_path / "out" / "study.csv").read_text(encoding="utf-8")
    assert "in P02/broken, P02" in shown and "P02/slow/rig.toml" in shown and str(tmp_path) not in shown


def test_a_failure_is_named_and_the_rest_is_finished(folder: Path, here: list[str], tmp_path: Path) -> None:
    news: list[str] = []
    study = run(folder, tmp_path / "out", progress=lambda stage, done, total, message="": news.append(message))
    assert news[0] == "4 trials" and list(study.failed) == ["P02/broken"]
    assert any(line.startswith("P02/broken: failed: ") for line in news)
    rows = list(csv.DictReader((tmp_path / "out" / "study.csv").open(encoding="utf-8")))
    assert [row["status"] for row in rows] == ["complete", "complete", "failed", "complete"]
    assert [row["time_steps"] for row in rows] == [str(FRAMES), str(FRAMES), "", str(FRAMES)]
    assert (tmp_path / "out" / "P01" / "fast" / "pose.trc").is_file()
    assert len(pf.read(tmp_path / "out" / "P02" / "slow").poses) == FRAMES
    assert "P02/broken" in rows[2]["reason"]


def test_the_command_shows_the_reason_of_a_failure_once(folder, here, tmp_path, capsys) -> None:
    shown = error(capsys, "batch", folder, "--out", tmp_path / "out", "--outputs", "trc", "--no-report", *as_options(SETTINGS))
    assert shown.count("P02/broken: failed: ") == 1 and "1 of 4 trials failed; the reasons are above and in" in shown


def test_what_a_failed_trial_lacks_is_named_as_what_a_study_takes(folder: Path, here: list[str], tmp_path: Path, capsys) -> None:
    """A trial without a rig named `--rig`, and one without a rate `--rate`: options of `track`, which `batch` does not have."""
    (tmp_path / "rig.toml").write_bytes((folder / "P01" / "rig.toml").read_bytes())
    (folder / "P02" / "slow" / "rig.toml").unlink()
    words = ["batch", str(folder), "--out", str(tmp_path / "out"), "--outputs", "trc", "--no-report"]
    shown = error(capsys, *words)
    named = set(re.findall(r"--set \w+=\w+|--[a-z]\S*", shown))
    assert named == {"--set rate_hz=HZ", "--set rig=FILE"}, shown
    for option, value in (("--set rate_hz=", "50"), ("--set rig=", str(tmp_path / "rig.toml"))):
        words += f"{option}{value}".split()
    shown = error(capsys, *words)
    assert "1 of 4 trials failed" in shown and "P02/broken: failed: " in shown


def test_what_a_trial_warns_of_is_named_as_what_a_study_takes(folder: Path, tmp_path: Path, monkeypatch) -> None:
    """People who are not followed are, with `people=N` of `track`: a study takes that among its settings."""
    line, tracked = others_line({"cam0": 2, "cam1": 1}, 1), tasks._tracked
    monkeypatch.setattr(tasks, "_tracked", lambda task: warnings.warn(line, stacklevel=1) or tracked(task))
    [option] = re.findall(r"--set \S+=", in_options(run_task(first_task(folder, tmp_path)).warnings[0]))
    assert read_config(None, {option.split()[1].removesuffix("="): 3}).associate.max_people == 3


def test_complete_trials_are_kept_and_others_tried_again(folder: Path, here: list[str], tmp_path: Path) -> None:
    run(folder, tmp_path / "out")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "P01").rglob("*")}
    here.clear()
    study = run(folder, tmp_path / "out")
    assert here == ["P02/broken"]
    assert study.kept == ("P01/fast", "P01/slow", "P02/slow")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out" / "P01").rglob("*")} == before


@pytest.mark.parametrize("refused", [False, True])
def test_two_runs_of_one_study_at_once_make_each_trial_once(folder, tmp_path, monkeypatch, refused: bool) -> None:
    """The other run completes all trials after this one has begun, or after this one was refused a trial that was being made."""
    out = tmp_path / "out"

    def here(tasks: Sequence[Task], *_: object) -> Iterator[Outcome]:
        yield from map(run_task, tasks)

    def meanwhile(tasks: Sequence[Task], *_: object) -> Iterator[Outcome]:
        monkeypatch.setattr(study_module, "_run", here)
        if refused:
            yield from [task.outcome(seconds=0.0, reason="another run is making these results now") for task in tasks]
        run(folder, out)
        if not refused:
            yield from map(run_task, tasks)

    monkeypatch.setattr(study_module, "_run", meanwhile)
    assert set(run(folder, out).failed) == {"P02/broken"}
    assert [row["status"] for row in csv.DictReader((out / "study.csv").open())].count("complete") == 3
    assert not list(out.glob("*/*.replaced-*"))


def test_a_table_that_differs_from_the_earlier_one_leaves_it(folder: Path, here: list[str], tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.rmtree(folder / "P02" / "broken")
    for _ in range(2):
        run(folder, out)
    assert not list(out.glob("*.replaced-*"))
    (out / "study.csv").write_text("with notes of mine")
    run(folder, out)
    [aside] = out.glob("*.replaced-*")
    assert aside.name.startswith("study.csv.") and aside.read_text() == "with notes of mine"
    assert "slow" in (out / "study.csv").read_text(encoding="utf-8")


def test_an_interrupted_trial_continues_from_its_detections(folder, here, tmp_path, monkeypatch) -> None:
    task = first_task(folder, tmp_path / "out")
    with monkeypatch.context() as broken:
        broken.setattr("posefuse.pipeline.track.write_result", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_task(task)
    assert unfinished_work(task.out) is not None
    monkeypatch.setattr("posefuse.pipeline.batch.tasks.ResultFolder", lambda **how: asked.append(how) or ResultFolder(**how))
    asked: list[dict[str, object]] = []
    assert run_task(task).reason == ""
    assert [how.get("resume") for how in asked] == [True]
    assert unfinished_work(task.out) is None


def interrupt(*arguments: object) -> None:
    raise KeyboardInterrupt


def test_other_settings_replace_results_only_when_asked(folder: Path, here: list[str], tmp_path: Path) -> None:
    run(folder, tmp_path / "out")
    here.clear()
    refusal(InputError, "made with other settings", run, folder, tmp_path / "out", settings={**SETTINGS, "raw": True})
    assert here == []
    study = run(folder, tmp_path / "out", settings={**SETTINGS, "raw": True}, replace=True)
    assert here == [trial.name for trial in study.trials]


def test_a_changed_session_is_noticed(folder: Path, here: list[str], tmp_path: Path) -> None:
    run(folder, tmp_path / "out")
    write_session(folder / "P02" / "slow" / "more", pf.read_rig(folder / "P01" / "rig.toml"))
    refusal(InputError, "P02/slow that were made with other", run, folder, tmp_path / "out")


def test_files_of_others_are_never_replaced(folder: Path, here: list[str], tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "study.csv").write_text("mine")
    refusal(InputError, r"study\.csv, which posefuse did not write", run, folder, tmp_path / "out")
    (tmp_path / "other" / "P02" / "slow").mkdir(parents=True)
    (tmp_path / "other" / "P02" / "slow" / "thesis.txt").write_text("mine")
    refusal(InputError, r"thesis\.txt", run, folder, tmp_path / "other")
    assert here == []
    refusal(InputError, "", run, folder, folder / "out")


def test_processes_do_what_this_process_does(folder: Path, here: list[str], tmp_path: Path) -> None:
    task = first_task(folder, tmp_path / "out")
    [outcome] = outcomes_here([task], jobs=2)
    assert Outcome.from_json(outcome.to_json()) == outcome
    assert outcome.reason == ""
    assert {**outcome.figures} == {**run_task(task).figures}


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_process_that_is_killed_is_one_failed_trial(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = first_task(folder, tmp_path / "out")

    class Killed(Worker):
        def start(self, *arguments: object) -> None:
            super().start(*arguments)
            os.kill(self.pid, signal.SIGKILL)

    monkeypatch.setattr("posefuse.pipeline.batch.processes.Worker", Killed)
    [outcome] = outcomes_here([task], 1)
    assert re.fullmatch(r"process \d+ ended by signal SIGKILL \(out of memory\?\)", outcome.reason)


def fails(channel: Channel, task: Task) -> None:
    """A trial with a bug in it."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("posefuse.pipeline.batch.processes.run_task", lambda task: 1 / 0)
        run_trial(channel, task)


def test_a_bug_is_the_reason_of_one_failed_trial(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    task = first_task(folder, tmp_path / "out")
    monkeypatch.setattr("posefuse.pipeline.batch.processes.run_trial", fails)
    [outcome] = outcomes_here([task], 1)
    assert outcome.reason == "ZeroDivisionError: division by zero"


def test_processes_end_when_no_more_outcomes_are_wanted(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a process ends by itself when the one that started it is gone: its channel is closed then."""
    tasks = [first_task(folder, tmp_path / "out")]
    started: list[Worker] = []

    class Noted(Worker):
        def start(self, *arguments: object) -> None:
            super().start(*arguments)
            started.append(self)
            raise KeyboardInterrupt

    monkeypatch.setattr("posefuse.pipeline.batch.processes.Worker", Noted)
    with pytest.raises(KeyboardInterrupt):
        next(outcomes_here(tasks, 1))
    assert started[0]._process.returncode is not None
    orphan = Worker(run_trial)
    orphan.start(tasks[0])
    orphan.channel.close()
    orphan._process.wait(60)
    assert not (tmp_path / "out").exists()


def test_at_least_one_trial_fits_into_a_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "usable_cores", lambda: 16)
    for free, jobs in ((None, 1), (1, 1), (5_000_000_000, 2), (10**12, 8)):
        monkeypatch.setattr(processes, "available_memory_bytes", lambda free=free: free)
        assert processes.default_jobs() == jobs


def test_without_a_scheduler_one_line_reports_it(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(processes, "_CONNECT_S", 0.5)
    with pytest.raises(InputError, match="no Dask scheduler answers there"):
        run(folder, tmp_path / "out", scheduler="tcp://127.0.0.1:9", progress=silent)


# --- a study on a Dask cluster: a real scheduler and two workers on the loopback, one of which is killed in the middle


TRIALS = 6


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    pytest.importorskip("distributed")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    place = f"tcp://127.0.0.1:{port}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["worker", place, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path)]
    with ExitStack() as stack, (tmp_path / "dask.log").open("w") as log:
        for arguments in (scheduler, worker, worker):
            command = [sys.executable, "-c", "import sys; from dask.__main__ import main; sys.exit(main())", *arguments]
            process = stack.enter_context(subprocess.Popen(command, stdout=log, stderr=log))
            stack.callback(process.kill)
        from distributed import Client

        with Client(place, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield place


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(address: str, ring_rig: Callable[..., Rig], tmp_path: Path) -> None:
    study, rig = tmp_path / "study", ring_rig(3)
    for i in range(TRIALS):
        write_session(study / f"P{i}" / "walk", rig)
    write_rig(study / "rig.toml", rig)
    killed: list[int] = []

    from distributed import Client

    with Client(address, timeout=60, set_as_default=False) as watcher:
        pids = watcher.run(os.getpid)

        def kill_one(stage: str, done: int, total: int | None, message: str = "") -> None:
            if stage == "trials" and done >= 1 and not killed:
                busy = [worker for worker, tasks in watcher.processing().items() if tasks]
                killed.append(pids[busy[0]])
                os.kill(killed[0], signal.SIGKILL)

        found = pf.batch(
            study, tmp_path / "out", formats=("trc",), report=False, scheduler=address, settings=SETTINGS, progress=kill_one
        )
        assert len(watcher.scheduler_info()["workers"]) == 1
    assert killed
    assert not found.failed
    assert len(found.rows()) == TRIALS
    assert all(len(pf.read(tmp_path / "out" / f"P{i}" / "walk").poses) for i in range(TRIALS))

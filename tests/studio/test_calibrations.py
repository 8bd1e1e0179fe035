"""What to do next: pure functions of what is known."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from checks import refusal

import posefuse as pf
from posefuse.api.calibration_results import RigCalibration, saved_clocks
from posefuse.api.rig_and_detector import rig_of
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, Check, CheckKind, RefusedCalibration
from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER, TargetCoverage
from posefuse.calibration.targets.kinds import read_target
from posefuse.core import CalibrationError, InputError
from posefuse_studio import calibrations
from posefuse_studio.calibrations import LENSES, NOTHING, RIG, SEEN, STEPS, Known, Project, SeenTarget, Step, StepResult
from posefuse_studio.work import calibrate
from posefuse_studio.workspace import StudioWorkspace, read_stored, write_stored

BARE = Project(name="room", setup="webcams")
READY = replace(BARE, cube="targets/cube.toml", board="targets/board.toml")
SIZES = {"marker_mm": 100, "columns": 5, "rows": 4, "square_mm": 30}


def result(
    step: str,
    passed: bool = True,
    *,
    recording: str = "one",
    detail: str = "",
    remedy: str = "",
    kind: CheckKind = "record",
    rests_on: str = "",
) -> StepResult:
    reports = [CalibrationReport(step, (Check("enough views", passed, detail, remedy, kind),))]
    return StepResult(passed=passed, recording=recording, rests_on=rests_on, reports=reports)


def none_yet(project: Project = READY) -> Known:
    return Known(project=project)


def after(*steps: Step, project: Project = READY) -> Known:
    """A project in which these steps have passed."""
    done = {step: replace(NOTHING, recording="one", result=result(step)) for step in steps}
    return Known(project=project, steps=done)


def changed(known: Known, step: Step, **changes: Any) -> Known:
    return replace(known, steps={**known.steps, step: replace(known[step], **changes)})


def filmed(known: Known, step: Step, recording: str = "one", **seen: Any) -> Known:
    """The same with a recording of a step."""
    about = SeenTarget(**{"target": READY.target(step), **seen})
    return changed(known, step, recording=recording, seen=about)


def recorded(workspace: StudioWorkspace, step: Step, project: Project | None = None, enough: bool = True) -> str:
    """The files of a recording; gives its name."""
    project = project or READY
    name = calibrations.new_recording(workspace, project, step)
    write_stored(workspace.folder(name) / SEEN, SeenTarget(enough=enough, target=project.target(step)))
    return name


def calculated(workspace: StudioWorkspace, step: Step, recording: str, passed: bool = True) -> None:
    """The files of a result."""
    folder = workspace.path(READY.folder)
    made = result(step, passed, recording=recording, rests_on=calibrations.rests_on(folder, step))
    if passed and step != "verify":
        (folder / {"intrinsics": LENSES, "extrinsics": RIG}[step]).write_text(recording, encoding="utf-8")
    write_stored(folder / f"{step}.json", made)


@pytest.fixture
def workspace(workspace: StudioWorkspace) -> StudioWorkspace:
    """With a calibration in which nothing is done yet."""
    calibrations.save_project(workspace, READY)
    return workspace


def test_the_steps_come_in_order() -> None:
    assert none_yet(BARE).next_step().action == "print"
    for number, step in enumerate(STEPS):
        known = after(*STEPS[:number])
        assert (known.next_step().action, known.next_step().step) == ("record", step)
        seen = filmed(known, step).next_step()
        assert (seen.action, seen.step) == ("solve", step)
    assert after(*STEPS).next_step().action == "use"


def test_a_refusal_gives_the_remedy_until_something_new_is_filmed() -> None:
    refusal = result("extrinsics", False, detail="right saw it 3 times", remedy="show it to right")
    known = changed(after("intrinsics"), "extrinsics", recording="one", result=refusal)
    step = known.next_step()
    assert (step.words, step.action) == ("show it to right", "record") and "right saw it 3 times" in step.why
    assert filmed(known, "extrinsics", "two").next_step().action == "solve"


@pytest.mark.parametrize(
    ("refused", "kind", "again"),
    [
        ("verify", "record", "verify"),
        ("verify", "rig", "extrinsics"),
        ("extrinsics", "lenses", "intrinsics"),
        ("extrinsics", "record", "extrinsics"),
    ],
)
def test_a_refusal_leads_to_the_step_that_is_to_blame(refused: Step, kind: CheckKind, again: Step) -> None:
    refusal = result(refused, False, remedy="calibrate again", kind=kind)
    known = changed(after(*STEPS), refused, result=refusal)
    step = known.next_step()
    assert (step.action, step.step) == ("record", again)


def test_clocks_of_an_earlier_calibration_are_not_applied(workspace: StudioWorkspace, monkeypatch, ring_rig: Any) -> None:
    recording = recorded(workspace, "extrinsics")
    cube, board = calibrations.print_targets(workspace, SIZES, "a4")
    seen = SimpleNamespace(of_patches=lambda ids: ())
    monkeypatch.setattr(calibrate, "observe_target", lambda *_, **__: seen)
    rig, applied = rig_of(ring_rig(2)), []

    def verified(path: Path, *_: Any, **__: Any) -> None:
        applied.append(saved_clocks(path.with_name("posefuse.toml"), rig))
        raise RefusedCalibration(CalibrationReport("rig", (Check("lengths", False, ""),)))

    monkeypatch.setattr(calibrate.pf, "verify", verified)
    for late_s in (0.12, 0.0):
        clocks = ClockEstimate.known(np.array([0.0, late_s]), 0.0) if late_s else None
        found = RigCalibration(rig=rig, report=CalibrationReport("extrinsics", ()), clocks=clocks)
        monkeypatch.setattr(calibrate.pf, "calibrate_extrinsics", lambda *_, found=found, **__: found)
        arguments = {"step": "extrinsics", "folder": READY.folder, "recording": recording, "target": cube}
        assert calibrate.run(arguments, workspace, None)["passed"]
        calibrate.run({**arguments, "step": "verify", "target": board}, workspace, None)
    assert applied == [{"cam01": pytest.approx(0.12)}, {}]


def test_any_number_of_recordings_of_a_step_can_be_made(workspace: StudioWorkspace) -> None:
    names = [recorded(workspace, step) for step in STEPS for _ in range(4)]
    assert names == [f"{READY.folder}/{step}-{n}" for step in STEPS for n in (1, 2, 3, 4)]
    assert calibrations.known_of(workspace, READY)["verify"].recording.endswith("verify-4")


def test_what_rests_on_a_step_that_was_done_again_is_outdated(workspace: StudioWorkspace) -> None:
    names = {}
    for step in STEPS:
        names[step] = recorded(workspace, step)
        calculated(workspace, step, names[step])

    def now() -> Known:
        return calibrations.known_of(workspace, READY)

    def outdated() -> set[Step]:
        return {step for step in STEPS if now()[step].outdated}

    assert outdated() == set() and now().next_step().action == "use"
    assert {now().step_light(step) for step in STEPS} == {("good", "passed")}
    # new lenses: the positions are calculated again, from their recording; until then nothing is verified
    calculated(workspace, "intrinsics", recorded(workspace, "intrinsics"))
    step = now().next_step()
    assert (step.action, step.step) == ("solve", "extrinsics") and outdated() == {"extrinsics"}
    assert now().step_light("extrinsics") == ("doubt", "rests on earlier lenses or positions")
    calculated(workspace, "extrinsics", names["extrinsics"])
    assert outdated() == set() and now().next_step().action == "use"
    # new positions: what was recorded before them shows the cameras as they stood then
    os.utime(workspace.path(names["verify"]) / SEEN, ns=(1, 1))
    calculated(workspace, "extrinsics", recorded(workspace, "extrinsics"))
    assert (now().next_step().action, now().next_step().step) == ("record", "verify")
    assert now()["verify"].current is None


def test_a_recording_of_another_target_is_not_calculated(workspace: StudioWorkspace) -> None:
    recorded(workspace, "intrinsics")
    assert calibrations.known_of(workspace, READY).next_step().action == "solve"
    other = replace(READY, board="targets/other.toml")
    assert calibrations.known_of(workspace, other).next_step().action == "record"


def test_a_recording_that_was_stopped_by_mistake_takes_no_result_away(workspace: StudioWorkspace) -> None:
    for step in STEPS:
        calculated(workspace, step, recorded(workspace, step))
        recorded(workspace, step, enough=False)
    known = calibrations.known_of(workspace, READY)
    assert known.next_step().action == "use" and known["verify"].recording.endswith("verify-1")
    # where there is nothing to lose, it can be used
    calculated(workspace, "verify", known["verify"].recording, passed=False)
    known = calibrations.known_of(workspace, READY)
    assert known["verify"].recording.endswith("verify-2") and known.next_step().action == "solve"


def test_a_recording_that_was_stopped_early_is_said_to_be() -> None:
    assert "enough" not in filmed(none_yet(), "intrinsics").next_step().why
    assert "stopped before enough was seen" in filmed(none_yet(), "intrinsics", enough=False).next_step().why


def test_the_calibration_that_was_worked_on_last_comes_first(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    assert calibrations.projects(workspace) == {}
    for name in ("hall", "room"):
        calibrations.save_project(workspace, replace(READY, name=name))
        os.utime(workspace.path(f"calibrations/{name}"), ns=(10**9, 10**9))
    recorded(workspace, "verify", project=replace(READY, name="hall"))
    assert list(calibrations.projects(workspace)) == ["hall", "room"]


def test_targets_are_offered_for_what_they_can_do(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    assert calibrations.targets(workspace, "verify") == []
    cube, board = calibrations.print_targets(workspace, SIZES, "a4")
    few = SIZES | {"columns": 4, "rows": 3}
    pf.print_target(workspace.path("targets/small.pdf"), {**few, "kind": "charuco", "marker_mm": 20}, page="a4")
    (workspace.path("targets") / "damaged.toml").write_text("kind = 3", encoding="utf-8")
    assert {step: calibrations.targets(workspace, step) for step in STEPS} == {
        "intrinsics": [board], "extrinsics": [cube], "verify": [board, "targets/small.toml"]
    }  # fmt: skip
    words = r"at least 8 corners .* got 6 on one of 4 x 3"
    refusal(CalibrationError, words, calibrations.print_targets, workspace, few, "a4")
    target = read_target(workspace.existing(cube))
    refusal(InputError, "a board for the lenses and the verification", calibrations.check_target, target, "verify")


def test_a_calculation_refuses_the_target_of_another_step(workspace: StudioWorkspace) -> None:
    cube, _ = calibrations.print_targets(workspace, SIZES, "a4")
    arguments = {"step": "verify", "folder": READY.folder, "recording": recorded(workspace, "verify"), "target": cube}
    refusal(InputError, "a board for the lenses and the verification", calibrate.run, arguments, workspace, None)


def test_a_project_is_found_again_with_its_newest_recording(workspace: StudioWorkspace) -> None:
    assert calibrations.projects(workspace) == {"room": READY}
    before = calibrations.stamp(workspace, READY)
    for number in (1, 2):
        seen = SeenTarget(enough=number == 2)
        write_stored(workspace.folder(f"{READY.folder}/verify-{number}") / SEEN, seen)
    workspace.folder(f"{READY.folder}/verify-3")
    write_stored(workspace.path(READY.folder) / "verify.json", result("verify", recording=f"{READY.folder}/verify-1"))
    known = calibrations.known_of(workspace, READY)
    assert before != calibrations.stamp(workspace, READY) == calibrations.stamp(workspace, READY)
    assert known["verify"].recording == f"{READY.folder}/verify-2" and known["verify"].seen == seen
    assert [step for step in STEPS if known[step].recording] == ["verify"]
    assert not known["verify"].passed
    with pytest.raises(InputError):
        calibrations.save_project(workspace, replace(READY, name="../x"))


def test_a_result_is_read_back_as_it_was(tmp_path: Path) -> None:
    made = replace(result("verify", False, detail="left", kind="rig"), position_cov_m2={"left": [[1e-6, 0.0], [0.0, 2e-6]]})
    made.reports[0] = replace(made.reports[0], numbers={"length_rms_mm": float("nan"), "lengths": 3.0}, notes=("a note",))
    write_stored(tmp_path / "verify.json", made)
    read = read_stored(tmp_path / "verify.json", StepResult)
    assert read is not None and replace(read, reports=[]) == replace(made, reports=[])
    [report] = read.reports
    assert (report.checks, report.notes, report.subject) == (made.reports[0].checks, ("a note",), "verify")
    assert np.isnan(report.numbers["length_rms_mm"]) and report.numbers["lengths"] == 3.0


def test_lenses_are_recorded_until_more_is_covered_than_their_calibration_refuses() -> None:
    """It counts the views that it chooses alone: 23% of what was seen in 25%."""
    cells = np.zeros((2, 6, 8))
    cells[:, :2] = 1
    found = TargetCoverage(("a", "b"), cells, np.full((2, 2), ENOUGH_TOGETHER))
    assert found.enough and not calibrations.enough_for("intrinsics", found)
    assert "33% covered, 35% needed" in calibrations.advice_for("intrinsics", found)
    more = cells.copy()
    more[:, 2, 0] = 1
    assert calibrations.enough_for("intrinsics", replace(found, cells=more))


def test_each_step_asks_for_what_it_needs_and_no_more() -> None:
    rng = np.random.default_rng(3)
    names = ("a", "b", "c")
    for _ in range(200):
        cells = rng.integers(0, 2, (3, 6, 8)) * (rng.random((3, 1, 1)) < 0.8)
        together = np.triu(rng.integers(0, 2 * ENOUGH_TOGETHER, (3, 3)))
        found = TargetCoverage(names, cells, together + np.triu(together, 1).T)
        ready = {step: calibrations.enough_for(step, found) for step in STEPS}
        assert not ready["extrinsics"] or ready["verify"]
        assert all(calibrations.advice_for(step, found).startswith("enough") == ready[step] for step in STEPS)
        # lenses: pairs do not matter; verification: images do not
        alone = replace(found, together=np.diag(np.diag(found.together)))
        assert calibrations.enough_for("intrinsics", alone) == ready["intrinsics"]
        assert not calibrations.enough_for("verify", alone)
        assert "same time" not in calibrations.advice_for("intrinsics", alone)
        assert not any("target" in calibrations.advice_for(step, found) for step in STEPS)
        assert calibrations.enough_for("verify", replace(found, cells=np.zeros_like(cells))) == ready["verify"]

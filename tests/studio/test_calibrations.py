"""What to do next, and the light of each camera: pure functions of what is known."""

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from posefuse.api.calibration_results import RigCalibration
from posefuse.api.rig import rig_of
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport
from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER, TargetCoverage
from posefuse.calibration.targets.kinds import Charuco, read_target, write_target
from posefuse.core import CalibrationError, InputError
from posefuse.formats.video import VideoWriter
from posefuse_studio.calibrations import (
    LENSES,
    RIG,
    Known,
    Project,
    Step,
    blamed_cameras,
    known_of,
    last_worked_on,
    lights,
    new_recording,
    next_step,
    projects,
    rests_on,
    save_project,
    step_light,
)
from posefuse_studio.camera_graph import graph_svg, graph_words, links
from posefuse_studio.guiding import NEAR_FAR, advice_for, enough_for, near_far_of, size_of
from posefuse_studio.jobs import write_json
from posefuse_studio.refusal_pictures import refusal_pictures
from posefuse_studio.targets import check_target, print_board, print_cube, targets
from posefuse_studio.work import calibrate
from posefuse_studio.workspace import StudioWorkspace

BARE = Project(name="room", setup="webcams")
READY = replace(BARE, cube="targets/cube.toml", board="targets/board.toml")
NOTHING = Known(cameras=("left", "right"))
STEPS: tuple[Step, ...] = ("intrinsics", "extrinsics", "verify")


def result(
    step: str, passed: bool = True, *, recording: str = "one", detail: str = "", remedy: str = "", kind: str = "record"
) -> dict[str, Any]:
    checks = [{"name": "enough views", "passed": passed, "detail": detail, "remedy": remedy, "kind": kind}]
    return {"step": step, "passed": passed, "recording": recording, "cameras": ["left", "right"],
            "reports": [{"subject": step, "checks": checks}]}  # fmt: skip


def after(*steps: Step) -> Known:
    """A project in which these steps have passed."""
    return replace(NOTHING, recordings=dict.fromkeys(steps, "one"), results={step: result(step) for step in steps})


def filmed(known: Known, step: Step, recording: str = "one", **seen: Any) -> Known:
    """The same with a recording of a step."""
    about = {"target": READY.target(step), "enough": True, **seen}
    return replace(known, recordings={**known.recordings, step: recording}, coverage={**known.coverage, step: about})


def recorded(workspace: StudioWorkspace, step: Step, project: Project | None = None, enough: bool = True) -> str:
    """The files of a recording; gives its name."""
    project = project or READY
    name = new_recording(workspace, project, step)
    seen = {"cameras": ["left"], "covered": [1.0], "linked": [[0.0]], "enough": enough, "target": project.target(step)}
    write_json(workspace.folder(name) / "coverage.json", seen)
    return name


def calculated(workspace: StudioWorkspace, step: Step, recording: str, passed: bool = True) -> None:
    """The files of a result."""
    folder = workspace.path(READY.folder)
    made = {**result(step, passed, recording=recording), "rests_on": rests_on(folder, step)}
    made["reports"][0]["numbers"] = {}
    if passed and step != "verify":
        (folder / {"intrinsics": LENSES, "extrinsics": RIG}[step]).write_text(recording, encoding="utf-8")
    write_json(folder / f"{step}.json", made)


def test_the_steps_come_in_order() -> None:
    assert next_step(BARE, NOTHING).action == "print"
    for number, step in enumerate(STEPS):
        known = after(*STEPS[:number])
        assert (next_step(READY, known).action, next_step(READY, known).step) == ("record", step)
        seen = filmed(known, step)
        assert (next_step(READY, seen).action, next_step(READY, seen).step) == ("solve", step)
    assert next_step(READY, after(*STEPS)).action == "use"


def test_lenses_from_the_cube_need_no_step_of_their_own() -> None:
    project = replace(READY, lenses=False)
    assert next_step(project, NOTHING).step == "extrinsics"
    assert lights(project, after("extrinsics"))["left"]["intrinsics"].state == "good"


def test_a_refusal_gives_the_remedy_until_something_new_is_filmed() -> None:
    refusal = result("extrinsics", False, detail="right saw it 3 times", remedy="show it to right")
    known = replace(after("intrinsics"), recordings={"intrinsics": "one", "extrinsics": "one"},
                    results={"intrinsics": result("intrinsics"), "extrinsics": refusal})  # fmt: skip
    step = next_step(READY, known)
    assert (step.words, step.action) == ("show it to right", "record") and "right saw it 3 times" in step.why
    assert [lights(READY, known)[name]["extrinsics"].state for name in ("left", "right")] == ["doubt", "bad"]
    assert step.back == ("intrinsics",)
    assert next_step(READY, filmed(known, "extrinsics", "two")).action == "solve"


@pytest.mark.parametrize(
    ("refused", "kind", "again", "others"),
    [
        ("verify", "record", "verify", ("intrinsics", "extrinsics")),
        ("verify", "rig", "extrinsics", ("intrinsics", "verify")),
        ("extrinsics", "lenses", "intrinsics", ("extrinsics",)),
        ("extrinsics", "clocks", "extrinsics", ("intrinsics",)),
    ],
)
def test_a_refusal_leads_to_the_step_that_is_to_blame(refused: Step, kind: str, again: Step, others: tuple[Step, ...]) -> None:
    known = after(*STEPS)
    known = replace(known, results={**known.results, refused: result(refused, False, remedy="calibrate again", kind=kind)})
    step = next_step(READY, known)
    assert (step.action, step.step, step.back) == ("record", again, others)
    without = next_step(replace(READY, lenses=False), known)
    assert "intrinsics" not in (without.step, *without.back)


def test_clocks_of_an_earlier_calibration_are_not_applied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ring_rig: Any) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    recording = recorded(workspace, "extrinsics")
    cube = print_cube(workspace, marker_mm=100, page="a4").target
    seen = SimpleNamespace(patch=np.zeros(0), rows=lambda keep: None, of_patches=lambda ids: ())
    monkeypatch.setattr(calibrate, "observe_target", lambda *_, **__: seen)
    monkeypatch.setattr(calibrate, "require_target_seen", lambda *_: None)
    rig = rig_of(ring_rig(2))
    for late_s in (0.12, 0.0):
        clocks = ClockEstimate.known(np.array([0.0, late_s]), 0.0) if late_s else None
        found = RigCalibration(rig=rig, report=CalibrationReport("extrinsics", ()), clocks=clocks)
        monkeypatch.setattr(calibrate, "calibrate_extrinsics", lambda *_, found=found, **__: found)
        arguments = {"step": "extrinsics", "folder": READY.folder, "recording": recording, "target": cube}
        assert calibrate.run(arguments, workspace, None)["passed"]
        offsets = calibrate._offsets(workspace.path(READY.folder) / calibrate.CLOCKS)
        assert offsets == ({"cam00": 0.0, "cam01": late_s} if late_s else {})


def test_any_number_of_recordings_of_a_step_can_be_made(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    names = [recorded(workspace, step) for step in STEPS for _ in range(4)]
    assert names == [f"{READY.folder}/{step}-{n}" for step in STEPS for n in (1, 2, 3, 4)]
    assert known_of(workspace, READY, ["left"]).recordings["verify"].endswith("verify-4")


def test_what_rests_on_a_step_that_was_done_again_is_outdated(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    names = {}
    for step in STEPS:
        names[step] = recorded(workspace, step)
        calculated(workspace, step, names[step])

    def now() -> Known:
        return known_of(workspace, READY, ["left"])

    assert now().outdated == frozenset() and next_step(READY, now()).action == "use"
    assert {step_light(step, READY, now()).state for step in STEPS} == {"good"}
    # new lenses: the positions are calculated again, from their recording; until then nothing is verified
    calculated(workspace, "intrinsics", recorded(workspace, "intrinsics"))
    step = next_step(READY, now())
    assert (step.action, step.step) == ("solve", "extrinsics") and now().outdated == {"extrinsics"}
    assert step_light("extrinsics", READY, now()).text == "rests on earlier lenses or positions"
    assert lights(READY, now())["left"]["verified"].state == "off"
    calculated(workspace, "extrinsics", names["extrinsics"])
    assert now().outdated == frozenset() and next_step(READY, now()).action == "use"
    # new positions: what was recorded before them shows the cameras as they stood then
    os.utime(workspace.path(names["verify"]) / "coverage.json", ns=(1, 1))
    calculated(workspace, "extrinsics", recorded(workspace, "extrinsics"))
    assert (next_step(READY, now()).action, next_step(READY, now()).step) == ("record", "verify")
    assert not now().passed("verify") and not now().refused("verify")


def test_a_recording_of_another_target_is_not_calculated(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    recorded(workspace, "intrinsics")
    assert next_step(READY, known_of(workspace, READY, ["left"])).action == "solve"
    other = replace(READY, board="targets/other.toml")
    assert next_step(other, known_of(workspace, other, ["left"])).action == "record"


def test_a_recording_that_was_stopped_by_mistake_takes_no_result_away(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    for step in STEPS:
        calculated(workspace, step, recorded(workspace, step))
        recorded(workspace, step, enough=False)
    known = known_of(workspace, READY, ["left"])
    assert next_step(READY, known).action == "use" and known.recordings["verify"].endswith("verify-1")
    # where there is nothing to lose, it can be used
    calculated(workspace, "verify", known.recordings["verify"], passed=False)
    known = known_of(workspace, READY, ["left"])
    assert known.recordings["verify"].endswith("verify-2") and next_step(READY, known).action == "solve"


def test_a_recording_that_was_stopped_early_is_said_to_be() -> None:
    assert "enough" not in next_step(READY, filmed(NOTHING, "intrinsics")).why
    assert "stopped before enough was seen" in next_step(READY, filmed(NOTHING, "intrinsics", enough=False)).why


def test_the_calibration_that_was_worked_on_last_is_opened(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    assert last_worked_on(workspace, projects(workspace)) == ""
    for name in ("hall", "room"):
        save_project(workspace, replace(READY, name=name))
        os.utime(workspace.path(f"calibrations/{name}"), ns=(10**9, 10**9))
    recorded(workspace, "verify", project=replace(READY, name="hall"))
    assert last_worked_on(workspace, projects(workspace)) == "hall"


def test_targets_are_offered_for_what_they_can_do(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    assert targets(workspace, "verify") == []
    small = print_board(workspace, columns=4, rows=3, square_mm=30, page="a4").target
    board = print_board(workspace, columns=5, rows=4, square_mm=30, page="a4").target
    cube = print_cube(workspace, marker_mm=100, page="a4").target
    (workspace.path("targets") / "damaged.toml").write_text("kind = 3", encoding="utf-8")
    assert {step: targets(workspace, step) for step in STEPS} == {
        "intrinsics": [board], "extrinsics": [cube], "verify": sorted([small, board])
    }  # fmt: skip
    with pytest.raises(CalibrationError, match=r"at least 8 corners .* got 6 on one of 4 x 3"):
        check_target(read_target(workspace.existing(small)), "intrinsics")
    with pytest.raises(InputError, match="a board for the lenses and the verification"):
        check_target(read_target(workspace.existing(cube)), "verify")


def test_a_calculation_refuses_the_target_of_another_step(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    cube = print_cube(workspace, marker_mm=100, page="a4").target
    arguments = {"step": "verify", "folder": READY.folder, "recording": recorded(workspace, "verify"), "target": cube}
    with pytest.raises(InputError, match="a board for the lenses and the verification"):
        calibrate.run(arguments, workspace, None)


def test_lights_turn_good_as_things_are_known() -> None:
    assert {light.state for light in lights(READY, NOTHING)["left"].values()} == {"off"}
    assert {light.state for name, light in lights(READY, after(*STEPS))["left"].items() if name != "overlap"} == {"good"}
    failed = replace(after(*STEPS), results={**after(*STEPS).results, "verify": result("verify", False)})
    assert lights(READY, failed)["left"]["verified"].state == "bad"


@pytest.mark.parametrize(
    ("linked", "covered", "state"), [(1.0, 1.0, "good"), (0.4, 1.0, "doubt"), (1.0, 0.2, "doubt"), (0.0, 1.0, "bad")]
)
def test_overlap_needs_a_partner_and_the_image(linked: float, covered: float, state: str) -> None:
    seen = {"cameras": ["left", "right"], "linked": [[1.0, linked], [linked, 1.0]], "covered": [covered, 1.0]}
    assert lights(READY, replace(NOTHING, coverage={"extrinsics": seen}))["left"]["overlap"].state == state


def test_a_project_is_found_again_with_its_newest_recording(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_project(workspace, READY)
    assert projects(workspace) == [READY]
    for number in (1, 2):
        name = f"{READY.folder}/verify-{number}"
        write_json(
            workspace.folder(name) / "coverage.json",
            {"cameras": ["left"], "covered": [1.0], "linked": [[0.0]], "enough": number == 2},
        )
    workspace.folder(f"{READY.folder}/verify-3")
    write_json(workspace.path(READY.folder) / "verify.json", result("verify", recording=f"{READY.folder}/verify-1"))
    known = known_of(workspace, READY, ["left"])
    assert known.recordings == {"verify": f"{READY.folder}/verify-2"} and known.coverage["verify"]["enough"]
    assert not known.passed("verify") and known.cameras == ("left",)
    with pytest.raises(InputError):
        save_project(workspace, replace(READY, name="../x"))


def test_each_step_asks_for_what_it_needs_and_no_more() -> None:
    rng = np.random.default_rng(3)
    names = ("a", "b", "c")
    for _ in range(200):
        cells = rng.integers(0, 2, (3, 6, 8)) * (rng.random((3, 1, 1)) < 0.8)
        together = np.triu(rng.integers(0, 2 * ENOUGH_TOGETHER, (3, 3)))
        found = TargetCoverage(names, cells, together + np.triu(together, 1).T)
        ready = {step: enough_for(step, found) for step in STEPS}
        assert not ready["extrinsics"] or (ready["intrinsics"] and ready["verify"])
        assert all(advice_for(step, found).startswith("enough") == ready[step] for step in STEPS)
        # lenses: pairs do not matter; verification: images do not
        alone = replace(found, together=np.diag(np.diag(found.together)))
        assert enough_for("intrinsics", alone) == ready["intrinsics"] and not enough_for("verify", alone)
        assert "same time" not in advice_for("intrinsics", alone)
        assert not any("target" in advice_for(step, found) for step in STEPS)
        assert enough_for("verify", replace(found, cells=np.zeros_like(cells))) == ready["verify"]


def test_lenses_from_a_cube_need_it_near_and_far() -> None:
    found = TargetCoverage(("a", "b"), np.ones((2, 6, 8)), np.full((2, 2), ENOUGH_TOGETHER))
    assert enough_for("extrinsics", found) and enough_for("extrinsics", found, np.full(2, NEAR_FAR))
    assert not enough_for("extrinsics", found, np.array([9.0, 1.1]))
    assert "near b" in advice_for("extrinsics", found, np.array([9.0, 1.1]))


def test_sizes_in_an_image_show_the_range_of_distances() -> None:
    square, focal_px = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) * 0.1, 500.0
    sizes = []
    for distance_m in np.linspace(2.0, 4.0, 100):
        turn, _ = cv2.Rodrigues(np.array([0.0, 0.7, 0.0]))
        xyz = square @ turn.T + [0, 0, distance_m]
        sizes.append(size_of(focal_px * xyz[:, :2] / xyz[:, 2:], np.zeros(4)))
    near, far = np.quantile(np.linspace(2.0, 4.0, 100), [0.05, 0.95])
    assert near_far_of([sizes, []]) == pytest.approx([far / near, 1.0], rel=0.05)
    assert np.isnan(size_of(np.zeros((3, 2)), np.zeros(3)))


def test_a_check_blames_the_cameras_that_it_names_and_no_other() -> None:
    check = {"subject": "rig", "detail": "cam1 and cam-2: seen 3 times", "remedy": "show it to cam3"}
    assert blamed_cameras(check, ("cam1", "cam10", "cam", "cam-2", "cam3", "2")) == ("cam1", "cam-2")
    assert blamed_cameras({"subject": "cam (left)", "detail": ""}, ("cam (left)",)) == ("cam (left)",)


def test_the_graph_shows_cameras_with_common_views_and_with_enough_of_them() -> None:
    n = ENOUGH_TOGETHER
    together = [[90, n, n - 1, 0], [n, 90, 0, 0], [n - 1, 0, 90, 0], [0, 0, 0, 5]]
    assert [(one.a, one.b, one.enough) for one in links(together)] == [(0, 1, True), (0, 2, False)]
    names = ("a", "b", "<c>", "d")
    assert graph_words(names, together) == f"a and b {n}; a and <c> {n - 1}, too few; d shares none"
    svg = graph_svg(names, together)
    assert "<c>" not in svg and "&lt;c&gt;" in svg
    assert svg.count("<line") == 2 and svg.count("stroke-dasharray") == 1 and svg.count("<circle") == 4
    ElementTree.fromstring(svg)


def test_a_refusal_has_a_picture_of_each_camera_that_it_names(tmp_path: Path) -> None:
    board = Charuco(columns=4, rows=3, square_m=0.2, marker_m=0.15)
    write_target(tmp_path / "board.toml", board)
    page = np.asarray(board.board().generateImage((320, 240), marginSize=20))
    videos = {}
    for name, shown in (("left", page), ("right", np.full_like(page, 90)), ("other", page)):
        videos[name] = tmp_path / f"{name}.mp4"
        with VideoWriter(videos[name], (320, 240), 10.0) as video:
            for i in range(12):
                # the target is there in one frame of the first half
                seen = shown if i in (3, 4) else np.full_like(page, 90)
                video.write(np.repeat(seen[..., None], 3, axis=2), i * 100_000_000)
    refusal = result("verify", False, detail="left and right: no common view")
    coverage = {"cameras": ["left", "right", "other"], "cells": np.zeros((3, 6, 8), int).tolist()}
    made = refusal_pictures(refusal, videos, tmp_path / "board.toml", tmp_path / "refused", coverage)
    assert [(name, path.name) for name, path in made.items()] == [("left", "verify-left.jpg"), ("right", "verify-right.jpg")]
    pictures = {name: cv2.imread(str(path)).astype(int) for name, path in made.items()}
    marked = {name: ((one[..., 0] - one[..., 1] > 60) & (one[..., 2] - one[..., 1] > 60)).sum() for name, one in pictures.items()}
    assert marked["left"] > 100 and marked["right"] == 0
    assert refusal_pictures(result("verify", False, detail="nothing named"), videos, tmp_path / "board.toml", tmp_path, {}) == {}

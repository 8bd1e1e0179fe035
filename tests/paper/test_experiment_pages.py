"""Every experiment's page and figures: on the bundled clip with an oracle, and, slowly, as a user runs them."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco")

from paper.__main__ import main
from paper.experiments import latency, runs, scaling
from paper.experiments.latency import SETTLED_S, STAGES, Listener, LiveTimes, live_figures, live_times, passages
from paper.experiments.runs import Console, Context, Run, run_scene
from paper.experiments.summary import write_summary
from paper.experiments.tables import joint_rows
from paper.scenes import paper
from paper.scenes.scaling import STUDIES, Errors, Study
from paper.scenes.scenes import CHECK_SEEDS, path_scene, walking_scene
from posefuse.core import SourceError
from posefuse.core.skeleton import PAPER14
from posefuse.outputs.live.udp import UdpStream
from posefuse.realtime.latency import ViewTimes

MADE_UP = Errors(1.0, 2.0, 1.0, 0.5, 1.0, 3.0)
FUSION = SimpleNamespace(
    latencies=SimpleNamespace(newest=(), rate_hz=100.0),
    monitor=SimpleNamespace(source=lambda _: SimpleNamespace(captured=10)),
    used={"cam00": 10},
    clock=SimpleNamespace(offset_ns=0),
)
CAMERAS = ("cam00", "cam01", "cam02", "cam03")
HEADINGS = {
    "static": ("T-pose, eight cameras", "No occlusion", "Occluded by walls, boxes and clutter"),
    "walking": ("Walking, four cameras", "Trajectories against the truth", "Six moments"),
    "latency": ("Latency, four cameras", "Live, as set: spikes over time"),
    "drift": ("Drift on three paths", "The suit", "circle", "back forth", "sideways"),
    "occlusion": ("Half of the body hidden", "No occlusion", "Screens hide the left half", "Screens, and false arms"),
    "scaling": ("What the error depends on",),
}
PICTURES = {"static": 6, "walking": 6, "latency": 0, "drift": 6, "occlusion": 12, "scaling": 0}
PLOTS = {"static": 0, "walking": 9, "latency": 4, "drift": 6, "occlusion": 9, "scaling": 8}


def overrides(session: Path) -> tuple[str, ...]:
    options = (f"truth={session / 'truth' / 'truth.npz'}", "noise.sigma_px=1.0")
    return ("detector.name=oracle", *(f"detector.options.{option}" for option in options), "end_s=0.5")


def context_of(session: Path, where: Path) -> Context:
    return Context(where, True, 1, "a test", Console(True), overrides(session))


def some_times(views: int = 60) -> LiveTimes:
    """Views of four cameras in turn, of which camera c needs 10 + c ms in the estimator and 1 ms elsewhere."""
    camera = np.arange(views) % 4
    spans_s = np.full((views, len(STAGES)), 0.001)
    spans_s[:, STAGES.index("2D")] = (10 + camera) / 1000
    exposed_s = SETTLED_S + np.arange(views) / 120
    passed_s = np.concatenate([exposed_s[:, None], exposed_s[:, None] + np.cumsum(spans_s, axis=1)], axis=1)
    return LiveTimes(CAMERAS, camera, passed_s, 0.5, 100.0)


@pytest.fixture
def on_the_clip(demo_session: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Whatever scene is asked for, the bundled clip is there already; its live session and the studies are made up."""
    monkeypatch.setattr(runs, "rendered", lambda *_: demo_session)
    monkeypatch.setattr(latency, "rendered", lambda *_: demo_session)
    monkeypatch.setattr(latency, "live_times", lambda *_: some_times())
    monkeypatch.setattr(scaling, "run_study", lambda name, *_: Study(*STUDIES[name][:2], (0.0, 1.0), (MADE_UP, MADE_UP)))
    return demo_session


@pytest.fixture
def done(on_the_clip: Path, tmp_path: Path) -> Run:
    return run_scene("x", walking_scene(), context_of(on_the_clip, tmp_path))


def check_page(out: Path, name: str, read_page: Callable) -> Any:
    """The page stands alone and holds what it should; the figures are JSON without NaN."""
    page = read_page(out / f"{name}.html")
    assert not re.search(r"\bnan\b", page.text, re.IGNORECASE)
    for heading in HEADINGS[name]:
        assert any(shown.startswith(heading) for shown in page.headings)
    assert len(page.images) == PICTURES[name]
    assert all(address.startswith("data:image/jpeg;base64,") for address in page.images)
    assert len(page.data.get("plots", ())) == PLOTS[name]
    for plot in page.data.get("plots", ()):
        assert plot["series"], plot["title"]
    content = json.loads((out / f"{name}.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)
    assert content["experiment"] == name and content["figures"] and content["machine"] and content["versions"]
    for said in (content["command"], content["settings"], content["length"]):
        assert said in page.text
    return page


@pytest.mark.parametrize("name", list(HEADINGS))
def test_a_page_holds_every_part(name: str, on_the_clip: Path, tmp_path: Path, read_page: Callable) -> None:
    options = [part for override in overrides(on_the_clip) for part in ("--set", override)]
    assert main([name, "--quick", "--out", str(tmp_path), *options]) == 0
    page = check_page(tmp_path, name, read_page)
    assert "--set detector.name=oracle" in page.text and "detector.options.noise.sigma_px=1.0, end_s=0.5" in page.text
    content = json.loads((tmp_path / f"{name}.json").read_text())
    assert content["length"].startswith("quick") and not (tmp_path / "accuracy.md").exists()
    figures = content["figures"]
    if name in ("static", "walking", "occlusion"):
        columns = {"static": "occluded", "walking": "columns", "occlusion": "screen"}
        columns = figures[columns[name]]
        columns = columns.get("columns", columns)
        assert columns["default"]["mean_mm"] < 15
        rows = {row[0]: row[1] for row in page.tables[1]}
        for joint in PAPER14.keypoints:
            assert re.fullmatch(r"\d+\.\d ± \d+\.\d", rows[joint.replace("_", " ")])


def test_settings_that_cannot_be_are_refused_before_anything_is_rendered(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(runs, "simulate", lambda *_: pytest.fail("rendered"))
    for override, complaint in (("detector.name=openpos", "openpos"), ("detector.options.landmark=x", "landmark"),
                                ("detector.options.landmarks=huge", "huge"),
                                ("fuse.weight=all", "weight")):  # fmt: skip
        assert main(["walking", "--quick", "--out", str(tmp_path), "--set", override]) == 1
        assert complaint in capsys.readouterr().err


def test_settings_change_what_is_fused(on_the_clip: Path, tmp_path: Path) -> None:
    context = context_of(on_the_clip, tmp_path)
    run = run_scene("x", walking_scene(), replace(context, overrides=(*context.overrides, "raw=true", "fuse.weights=score")))
    assert run.config.fuse.weights == "score" and run.recording.provenance["config"]["raw"] is True
    assert run.default_errors().mpjpe_mm == pytest.approx(run.errors("score", smoothed=False).mpjpe_mm)
    assert run.default_errors().mpjpe_mm != run.errors("robust").mpjpe_mm


def test_a_scene_is_rendered_once_and_finished_where_it_broke_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Path] = []

    def simulated(scene: object, folder: Path, *_: object) -> None:
        made.append(folder)
        (folder / "truth").mkdir(parents=True, exist_ok=True)
        (folder / "truth" / "truth.npz").touch()

    monkeypatch.setattr(runs, "simulate", simulated)
    context = Context(tmp_path, True, 1, "a test", Console(True))
    folder = runs.rendered("x", walking_scene(), context)
    assert runs.rendered("x", walking_scene(), context) == folder and len(made) == 1
    (folder / "truth" / "truth.npz").unlink()
    runs.rendered("x", walking_scene(), context)
    assert made == [folder, folder]
    others = {runs.rendered("x", scene, context) for scene in (walking_scene(2), path_scene("circle"), path_scene("circle", 5.0))}
    assert len(others - {folder}) == 3


def test_joints_stand_next_to_the_papers(done: Run) -> None:
    from paper.experiments.tables import errors_row

    head, rows = joint_rows({"ours": errors_row(done.default_errors())}, paper.STATIC["free"], {"other": (3.0, 1.0, 9.0)})
    assert head == ["joint (mm)", "ours", "paper: none", "paper: score", "paper: all", "other"]
    assert [row[0] for row in rows] == [*(j.replace("_", " ") for j in PAPER14.keypoints), "average", "best joint", "worst joint"]
    assert rows[0][2:] == ["13.4 ± 0.4", "13.0 ± 0.4", "14.6 ± 0.4", "–"]
    assert rows[-3][-2:] == ["10.48", "3.00"] and rows[-2][-1] == "1.00" and rows[-1][2] == "376.84"
    assert float(rows[-3][1]) == pytest.approx(done.default_errors().mpjpe_mm, abs=0.005)


def test_a_view_is_followed_to_the_datagram_of_its_pose() -> None:
    zero, ms = 5_000_000_000, 1_000_000
    at = lambda *passed_ms: [zero + round(t * ms) for t in passed_ms]  # noqa: E731
    ways = [
        (ViewTimes("b", *at(0, 2, 3, 13, 14)), zero + 20 * ms + 1),
        (ViewTimes("a", *at(8, 9, 15, 25, 26)), zero + 30 * ms + 2),
        # its pose never came
        (ViewTimes("a", *at(20, 21, 22, 32, 33)), zero + 40 * ms),
    ]
    arrivals = {zero + 20 * ms: zero + 22 * ms, zero + 30 * ms: zero + 31 * ms}
    camera, passed_s = passages(ways, arrivals, ("a", "b"), zero)
    assert camera.tolist() == [1, 0]
    np.testing.assert_allclose(passed_s, np.array([[0, 2, 3, 13, 14, 20, 22], [8, 9, 15, 25, 26, 30, 31]]) / 1000, atol=1e-7)
    times = LiveTimes(("a", "b"), camera, passed_s, 1.0, 100.0)
    np.testing.assert_allclose(times.stages_ms.sum(axis=1), times.total_ms)
    assert len(passages(ways, {}, ("a", "b"), zero)[0]) == 0


def test_the_listener_remembers_when_each_pose_first_came() -> None:
    with Listener() as listener:
        stream, before_ns = UdpStream([listener.address]), time.monotonic_ns()
        stream.send([b'{"t_ns": 7, "person": 0}', b'{"t_ns": 7, "person": 1}', b'{"t_ns": 9, "person": 0}'])
        end = time.monotonic() + 5
        while len(listener.arrivals_ns()) < 2 and time.monotonic() < end:
            time.sleep(0.01)
        stream.close()
    arrivals = listener.arrivals_ns()
    assert list(arrivals) == [7, 9] and before_ns <= arrivals[7] <= arrivals[9] <= time.monotonic_ns()


def test_live_figures_are_those_of_each_camera() -> None:
    live = some_times()
    figures = live_figures(live, dict.fromkeys(CAMERAS, 2.0))
    for c, name in enumerate(CAMERAS):
        one = figures["cameras"][name]
        assert one["stages_ms"]["2D"]["mean"] == pytest.approx(10 + c)
        assert one["total_ms"]["median"] == pytest.approx(15 + c) and one["views"] == 15
    lines = latency.view_spikes(live, 2, float(np.median(live.passed_s[:, 0])))
    assert [line.name for line in lines] == list(STAGES)
    np.testing.assert_allclose([lines[0].low[0], lines[0].high[0]], [0, 1], atol=1e-9)
    np.testing.assert_allclose([lines[-1].low[0], lines[-1].high[0]], [16, 17], atol=1e-9)
    # a camera none of whose views got through has no row, and breaks nothing
    silent = LiveTimes(CAMERAS, live.camera[live.camera != 3], live.passed_s[live.camera != 3], 0.5, 100.0)
    figures = live_figures(silent, dict.fromkeys(CAMERAS, 2.0))
    assert list(figures["cameras"]) == list(CAMERAS[:3])
    plots: Any = latency.spike_plots(silent)
    assert [len(plot.series[0].x) > 0 for plot in plots] == [True, True, True, False]


@pytest.mark.usefixtures("on_the_clip", "models")
def test_latency_is_measured_on_each_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, read_page: Callable) -> None:
    used = []

    def played(folder: Path, context: Context, *_: float) -> LiveTimes:
        used.append(context.config.detector.options["device"])
        return some_times()

    monkeypatch.setattr(latency, "live_times", played)
    monkeypatch.setattr("paper.__main__._check_detector", lambda _: None)
    assert main(["latency", "--quick", "--device", "cpu", "--device", "openvino:gpu", "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "latency.json").read_text())
    assert used == list(content["figures"]["live"]) == ["cpu", "openvino:gpu"]
    assert content["command"] == "python -m paper latency --quick --device cpu --device openvino:gpu"
    rows = read_page(tmp_path / "latency.html").tables[-2]
    assert [row[0] for row in rows[1:]] == ["cpu", "openvino:gpu", "paper", "paper"]
    assert main(["static", "--quick", "--device", "cpu", "--device", "cuda", "--out", str(tmp_path / "other")]) == 1


def test_a_graphics_card_is_named_by_the_program_of_its_maker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "cores" in latency.processor_of("cuda:1")
    program = tmp_path / "nvidia-smi"
    program.write_text('#!/bin/sh\necho "card $3"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin:/usr/bin")
    assert latency.processor_of("cuda:1") == "card --id=1" and latency.processor_of("tensorrt") == "card --id=0"
    assert "cores" in latency.processor_of("cpu")


@pytest.mark.realtime
def test_a_session_played_live_gives_every_views_passage(demo_session: Path, tmp_path: Path) -> None:
    times = live_times(demo_session, context_of(demo_session, tmp_path), 2.5)
    assert times.cameras == CAMERAS and set(times.camera) == {0, 1, 2, 3} and len(times.camera) > 20
    assert (times.passed_s[:, 0] >= SETTLED_S).all()
    assert (times.stages_ms > -5).all() and (times.total_ms > 0).all()


def test_a_live_session_without_a_pose_is_reported(demo_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "passages", lambda *_: (np.zeros(0, int), np.zeros((0, len(STAGES) + 1))))
    monkeypatch.setattr(latency, "run_live", lambda *_: SimpleNamespace(fusion=FUSION, zero_ns=0))
    with pytest.raises(SourceError, match="played live for 3 s, and no view of 40 led to a pose"):
        live_times(demo_session, context_of(demo_session, tmp_path), 3.0)


def test_the_summary_has_the_papers_tables(on_the_clip: Path, done: Run, tmp_path: Path) -> None:
    from paper.experiments.static import _columns
    from paper.experiments.tables import errors_row

    columns = {name: errors_row(errors) for name, errors in _columns(done).items()}
    check = {str(seed): {"default": columns["default"], "landmarks": columns["robust"]} for seed in CHECK_SEEDS}
    means = {seed: {name: column["mean_mm"] for name, column in one.items()} for seed, one in check.items()}
    all_figures = {
        "static": {"free": columns, "occluded": columns, "check": {"free": means, "occluded": means}},
        "walking": {"columns": columns, "check": check, "nees": {"smoothed": 3.0}},
        "latency": {"live": {"cpu": {"processor": "two cores", **live_figures(some_times(), dict.fromkeys(CAMERAS, 2.0))}}},
    }
    for name, figures in all_figures.items():
        content = {"length": "full", "command": f"python -m paper {name}", "date": "2026-01-01", "machine": "m"}
        (tmp_path / f"{name}.json").write_text(json.dumps({**content, "figures": figures}))
    (tmp_path / "drift.json").write_text(json.dumps({"length": "quick: seconds of everything"}))
    text = write_summary(tmp_path).read_text()
    assert text.count("| right wrist | ") == 3 and text.count(" ± ") >= 3 * 14 * 5
    assert "| joint (mm) | none | score | all | robust | default | paper: none | paper: score | paper: all |" in text
    assert "| cam02 | 1.0 | 1.0 | 12.0 | 1.0 | 1.0 | 1.0 | 17.0 | 17.0 | 2.0 |" in text
    assert "| cpu | two cores | 11.5 | 1.0 | 16.5 | 18.0 | 50.0 |" in text
    assert "| paper | the slowest of three GPUs | 125.0 | 1.0 | – | – | – |" in text
    assert "25.83" in text and "Drift" not in text


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rendered once for all experiments."""
    return tmp_path_factory.mktemp("sessions")


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("name", list(HEADINGS))
def test_an_experiment_runs_end_to_end(name: str, sessions: Path, models: None, tmp_path: Path, read_page: Callable) -> None:
    assert main([name, "--quick", "--out", str(tmp_path), "--sessions", str(sessions)]) == 0
    check_page(tmp_path, name, read_page)

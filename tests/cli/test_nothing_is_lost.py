"""No command removes or changes a file that posefuse did not write, wherever its output is sent; names print as they are."""

import dataclasses
import errno
import glob
import hashlib
import os
import shutil
import tempfile
import zipfile
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import DEMO, as_options, error, oracle, tracked
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from posefuse.api.calibration_results import save_clocks, write_rig_file
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport
from posefuse.cli.calibrate import RigOptions, check_files
from posefuse.cli.main import main
from posefuse.core import InputError, PosefuseError
from posefuse.detection.card import read_card
from posefuse.detection.download import WheelSource
from posefuse.detection.files import fetch_all
from posefuse.formats.rig import read_rig
from posefuse.foundation.output_file import earlier_kept
from posefuse.foundation.output_folder import MARK_FILE, OutputFolder, growing_folder
from posefuse.pipeline.config import CONFIG_FILE

Command = Callable[[Path, bool], int]


def tree(folder: Path) -> dict[str, bytes | None]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.fixture(scope="module")
def results(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a result, R."""
    return tracked(demo_session, tmp_path_factory.mktemp("results") / "R").parent


@pytest.mark.parametrize(
    ("out", "reason"),
    [(".", "is the input"), ("../link", "is the input"), ("videos", "lies inside the input"), ("..", "contains the input")],
)
def test_a_session_is_not_tracked_into_itself(demo_session: Path, tmp_path: Path, capsys, out: str, reason: str) -> None:
    session = Path(shutil.copytree(demo_session, tmp_path / "S"))
    (tmp_path / "link").symlink_to(session)
    before = tree(tmp_path)
    assert reason in error(capsys, "track", session, "--out", session / out, "--force")
    assert tree(tmp_path) == before


@pytest.mark.parametrize(("scene", "reason"), [("p/scene.yaml", "contains the input"), ("scene.yaml", "raw.bin")])
@pytest.mark.parametrize("force", [[], ["--force"]])
def test_a_scene_is_not_simulated_over_files_of_the_user(tmp_path, capsys, force: list[str], scene: str, reason: str) -> None:
    (tmp_path / "p").mkdir()
    (tmp_path / "p" / "raw.bin").write_text("the user's")
    (tmp_path / scene).write_text("duration_s: 1\ncameras: {kind: ring}\n")
    before = tree(tmp_path)
    assert reason in error(capsys, "simulate", tmp_path / scene, "--out", tmp_path / "p", *force)
    assert tree(tmp_path) == before


def test_a_second_report_keeps_the_first_with_the_users_notes(results: Path, tmp_path: Path, capsys) -> None:
    result = Path(shutil.copytree(results / "R", tmp_path / "R"))
    assert main(["report", str(result), "--fit", "none"]) == 0
    (result / "biomechanics" / "notes.txt").write_text("the user's")
    before = tree(result / "biomechanics")
    assert main(["report", str(result), "--fit", "none"]) == 0
    [aside] = result.glob("biomechanics.replaced-*")
    assert tree(aside) == before
    assert f"the earlier results are kept in {aside}" in " ".join(capsys.readouterr().err.split())
    assert not (result / "biomechanics" / "notes.txt").exists()


MODEL_FILE = "pose_landmark_full.tflite"
# names that commands write themselves, or wrote once, and some of the user's
NAMES = st.sampled_from(
    ["report.html", "recording.json", "recording.npz", "rig.toml", "scene.yaml", "INCOMPLETE", MARK_FILE, "compare.json"]
    + ["compare.html", "walking.json", "out", "out.partial", "videos", "thesis [final].docx", "x[/b]", ".hidden"]
    + ["posefuse.toml", "models", MODEL_FILE]
)
TREES = st.dictionaries(st.lists(NAMES, min_size=1, max_size=3).map("/".join), st.binary(max_size=20), max_size=6)
PLACES = st.sampled_from([".", "out", "out/deep", "videos", "x[/b]"])


def grow(folder: Path, files: dict[str, bytes]) -> dict[Path, bytes]:
    """Write what can be written of a tree; returns the foreign files: those that were not there before."""
    made = {}
    for name, content in files.items():
        path = folder / name
        if path.exists() or any(parent.is_file() for parent in path.parents):
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        made[path] = content
    return made


def check_nothing_is_lost(command: Command, files: dict[str, bytes], place: str, again: bool, force: bool) -> None:
    """Run the command into a random tree, also over its own earlier result. Every foreign file stays unchanged."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "user"
        folder.mkdir()
        if again:
            command(folder / place, force)
        foreign = grow(folder, files)
        code = command(folder / place, force)
        assert code in (0, 1)
        for path, content in foreign.items():
            assert survives(path, content, Path(name)), path


def survives(path: Path, content: bytes, within: Path) -> bool:
    """Whether a file is as it was, or it or a folder that it lies in was moved to NAME.replaced-TIME."""
    places = [within]
    for part in path.relative_to(within).parts:
        patterns = (glob.escape(part), f"{glob.escape(part)}.replaced-*")
        places = [found for place in places for pattern in patterns for found in place.glob(pattern)]
    return any(one.is_file() and one.read_bytes() == content for one in places)


@pytest.mark.parametrize(("command", "finished"), [("reported", "angles.csv"), ("compared", "compare.json")])
def test_a_disk_that_becomes_full_keeps_what_was_computed_until_then(
    tmp_path: Path, results: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture, command: str, finished: str
) -> None:
    write = Path.write_text

    def no_room(self: Path, *args: Any, **options: Any) -> int:
        if self.suffix == ".html":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(self, *args, **options)

    monkeypatch.setattr(Path, "write_text", no_room)
    assert globals()[command](results, tmp_path / "out", False) == 1
    [line] = [line for line in capsys.readouterr().err.splitlines() if line.startswith("posefuse ")]
    assert "No space left on device" in line
    [left] = tmp_path.glob(".out.*.unfinished")
    assert line.endswith(f"what was finished until then is kept in {left}")
    assert (left / finished).stat().st_size > 100


def tracked_again(results: Path, out: Path, force: bool) -> int:
    return main(["track", str(DEMO), "--out", str(out), *as_options(oracle()), "--end", "0.3", *(["--force"] if force else [])])


def reported(results: Path, out: Path, force: bool) -> int:
    return main(["report", str(results / "R"), "--fit", "none", "--out", str(out)])


def compared(results: Path, out: Path, force: bool) -> int:
    return main(["compare", str(results / "R"), str(results / "R"), "--out", str(out)])


def printed(results: Path, out: Path, force: bool) -> int:
    return main(["calibrate", "print", "--cube", "--marker-mm", "100", "--out", str(out)])


def experimented(results: Path, out: Path, force: bool) -> None:
    """What `python -m paper` does around its experiments."""
    made = growing_folder(out, command="experiment", names=["walking.json"])
    with earlier_kept(made / "walking.json"):
        (made / "walking.json").write_text("{}")


def calibrated(results: Path, out: Path, force: bool) -> None:
    """What `posefuse calibrate extrinsics`, `intrinsics` and `person` do before and after their work."""
    rig = read_rig(results / "R" / "rig.toml")
    path, report = out / "rig.toml", out / "report.html"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(str(error)) from None
    check_files(RigOptions(out=path, report=report, replace=force))
    write_rig_file(path, rig)
    CalibrationReport("rig", ()).save(report, rig=rig)
    save_clocks(out / CONFIG_FILE, rig.names, ClockEstimate.known(0.1 * np.arange(len(rig)), 0.0))


def models_fetched(results: Path, out: Path, force: bool) -> None:
    """`posefuse models`, for a network of a few bytes."""
    content, wheel = b"a network", results / "mediapipe-1-x.whl"
    sha256 = hashlib.sha256(content).hexdigest()
    card = dataclasses.replace(read_card("blazepose_full"), size_bytes=len(content), sha256=sha256)
    if not wheel.exists():
        with zipfile.ZipFile(wheel, "w") as archive:
            archive.writestr(card.source.member, content)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(WheelSource, "download", lambda *_: wheel)
        assert fetch_all([card], out)[0].name == MODEL_FILE


def simulated(results: Path, out: Path, force: bool) -> None:
    """`posefuse simulate` with everything but the pictures."""
    from posefuse_sim import read_scene
    from posefuse_sim import session as sessions

    scene = results / "scene.yaml"
    scene.write_text("duration_s: 0.1\ncameras: {kind: ring, count: 1}\n")
    with pytest.MonkeyPatch.context() as patched:
        for name in ("working_backend", "_job", "_render"):
            patched.setattr(sessions, name, lambda *_: None)
        patched.setattr(sessions, "finish_session", lambda live, paths: paths.rig.write_text("a rig"))
        sessions.simulate(read_scene(scene), out, replace=force)


COMMANDS = [tracked_again, reported, compared, printed, experimented, calibrated, models_fetched, simulated]


@pytest.mark.parametrize("work", COMMANDS)
def test_foreign_files_are_unchanged_after_every_command(work: Callable[[Path, Path, bool], int | None], results: Path) -> None:
    def command(out: Path, force: bool) -> int:
        """Its exit code, or that of what is done in its place."""
        try:
            return work(results, out, force) or 0
        except PosefuseError:
            return 1

    # each example of the first two is a second of work
    count = 8 if work in (tracked_again, reported) else 25

    @settings(max_examples=count, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck))
    @example({"thesis [final].docx": b"x", "report.html": b"x"}, ".", False, True)
    @example({"out/deep/thesis [final].docx": b"x"}, "out", True, True)
    @example({"out.partial/raw": b"x"}, "out", True, True)
    @example({f"out/models/{MODEL_FILE}": b"x", "out/rig.toml": b"x"}, "out", False, True)
    @example({"out/posefuse.toml": b"x", "out/parts/x": b"x", "out/.DS_Store": b"x"}, "out", True, True)
    @given(TREES, PLACES, st.booleans(), st.booleans())
    def check(files: dict[str, bytes], place: str, again: bool, force: bool) -> None:
        check_nothing_is_lost(command, files, place, again, force)

    with tempfile.TemporaryDirectory() as fresh:
        assert command(Path(fresh) / "out", False) == 0, "it writes where nothing is"
    check()


def test_the_check_detects_the_old_rule_that_deleted_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """One name in common was once taken for a result of one's own, and NAME.partial for a leftover."""

    @contextmanager
    def as_it_was(path: Path, **_: object):
        partial = path.with_name(path.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        yield OutputFolder(folder=partial, target=path)
        if path.exists():
            names = {entry.name for entry in path.iterdir()}
            if names and not names & {entry.name for entry in partial.iterdir()}:
                return
            shutil.rmtree(path)
        partial.rename(path)

    def write(out: Path, force: bool) -> int:
        with as_it_was(out) as made:
            (made.folder / "report.html").write_text("new")
        return 0

    for files in ({"out/report.html": b"x", "out/thesis": b"x"}, {"out.partial/raw": b"x"}):
        with pytest.raises((AssertionError, FileNotFoundError)):
            check_nothing_is_lost(write, files, "out", again=False, force=False)
    with pytest.raises((AssertionError, FileNotFoundError)):
        check_nothing_is_lost(write, {"out/notes.txt": b"x"}, "out", again=True, force=False)


@pytest.mark.parametrize("text", ["take [final]", "x[/b]", "posefuse[biomech]"])
def test_titles_columns_and_progress_print_square_brackets_unchanged(text: str, capsys) -> None:
    from posefuse.cli.terminal import Terminal
    from posefuse.foundation.summary import Facts, Heading, Table

    terminal = Terminal(as_json=False)
    table, facts = Table((f"column {text}",), [(f"cell {text}",)]), Facts({f"name {text}": f"value {text}"})
    terminal.show([Heading(f"title {text}"), table, Heading(f"facts {text}"), facts])
    with terminal.stages() as progress:
        progress(f"label {text}", 1, 1)
    printed = "".join(capsys.readouterr())
    for part in ("title", "column", "cell", "facts", "name", "value", "label"):
        assert f"{part} {text}" in printed

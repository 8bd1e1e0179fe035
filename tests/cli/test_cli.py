"""The command line: figures as JSON on stdout and nothing else there, one line and exit 1 for a known error, 2 for a bug."""

import errno
import json
import os
import re
import signal
import sys
import threading
import time
import tomllib
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import SimpleNamespace

import pytest
from checks import refusal
from running import python

import posefuse
from posefuse import __version__
from posefuse.api import machine
from posefuse.api.live_run import live_summary
from posefuse.cli import machine as machine_commands
from posefuse.cli import main as cli
from posefuse.cli.command_line import COMMANDS, STEPS, application
from posefuse.cli.options import Figures, Shown
from posefuse.cli.stopping import terminate_on_signals
from posefuse.cli.terminal import Terminal, in_options
from posefuse.core import DependencyError
from posefuse.formats.page import Heading, Page, Table, write_page
from posefuse.foundation.requests_to_end import REQUESTS_TO_END
from posefuse.realtime.latency import STAGES

DEMO = str(Path(__file__).parents[2] / "examples" / "demo")


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    try:
        code = cli.main(list(argv))
    except SystemExit as left:
        code = int(left.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("command", ["plugins", "doctor"])
def test_json_is_alone_on_stdout_and_has_the_values_of_the_table(command: str, capsys) -> None:
    code, out, err = run(capsys, command, "--json")
    figures = json.loads(out)
    assert code == 0
    assert (figures["command"], figures["version"]) == (command, __version__)
    assert err.strip()
    code, out, _ = run(capsys, command)
    assert code == 0
    assert "┃" in out or "│" in out
    with pytest.raises(json.JSONDecodeError):
        json.loads(out)


def test_doctor_names_what_is_needed(capsys) -> None:
    checks = {check["name"]: check for check in json.loads(run(capsys, "doctor", "--json")[1])["checks"]}
    assert checks["Python"]["needed"] and checks["Python"]["ok"]
    assert not checks["disk"]["needed"]
    assert all(check["ok"] or check["cure"] for check in checks.values())


def test_doctor_is_ready_before_the_first_download(monkeypatch: pytest.MonkeyPatch, capsys, tmp_path: Path) -> None:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    figures = json.loads(run(capsys, "doctor", "--json")[1])
    checks = {check["name"]: check for check in figures["checks"]}
    assert figures["ready"] and "after the first download" in checks["tracking"]["found"]
    assert not checks["model blazepose_full"]["ok"] and not checks["model blazepose_full"]["needed"]


@pytest.mark.parametrize("there", [True, False])
def test_doctor_of_a_cache_that_can_only_be_read(there: bool, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """`track` works with networks that another user has put there; it cannot fetch any."""
    monkeypatch.setattr(machine, "status", lambda card, folder: "ready" if there else "missing")
    monkeypatch.setattr("os.access", lambda path, mode: mode != os.W_OK)
    [cache] = [one for one in json.loads(run(capsys, "doctor", "--json")[1])["checks"] if one["name"] == "model cache"]
    assert not cache["ok"] and "cannot be written" in cache["found"] and "POSEFUSE_CACHE" in cache["cure"]
    assert cache["needed"] is not there


@pytest.mark.parametrize("system", ["win32", "darwin"])
def test_doctor_on_systems_with_a_desktop(monkeypatch: pytest.MonkeyPatch, system: str) -> None:
    """Cameras by the names that FFmpeg lists."""
    devices = [SimpleNamespace(name="0", description="Logitech BRIO", media_types=["video"])]
    monkeypatch.setattr("av.enumerate_input_devices", lambda kind: devices, raising=False)
    monkeypatch.setattr("posefuse.foundation.platform.sys", SimpleNamespace(platform=system))
    assert machine._cameras().found == {"win32": "Logitech BRIO", "darwin": "0"}[system]


def test_doctor_is_not_ready_where_track_cannot_begin(monkeypatch: pytest.MonkeyPatch, capsys, models: None) -> None:
    """It tries what it promises: here a name of the standard library is missing, as on another system."""

    def build(config: object) -> None:
        raise AttributeError("module 'os' has no attribute 'sched_getaffinity'")

    assert json.loads(run(capsys, "doctor", "--json")[1])["ready"]
    monkeypatch.setattr("posefuse.detection.BlazePoseConfig.build", build)
    code, out, err = run(capsys, "doctor", "--json")
    [tracking] = [check for check in json.loads(out)["checks"] if check["name"] == "tracking"]
    assert code == 0 and not json.loads(out)["ready"]
    assert "sched_getaffinity" in tracking["found"] and tracking["cure"]
    assert "Not ready" in err and "Ready:" not in err


def test_commands_need_no_docstrings(tmp_path: Path) -> None:
    """Python leaves them out where PYTHONOPTIMIZE is 2, as in some containers: help has fewer words then."""
    done = python("-m", "posefuse", "track", str(tmp_path / "nowhere"), "--out", str(tmp_path / "o"), PYTHONOPTIMIZE="2")
    assert (done.returncode, done.stdout) == (1, "") and done.stderr.count("\n") == 1
    assert "no such session folder" in done.stderr


def test_demo_takes_the_clip_of_the_package_and_prints_the_next_step(monkeypatch, capsys, tmp_path, demo_session) -> None:
    taken = []
    made = SimpleNamespace(summary=list, figures={"people": 1})
    stand_in = wraps(posefuse.track)(lambda *given, **options: taken.append((*given, options)) or made)
    monkeypatch.setattr(posefuse, "track", stand_in)
    code, out, err = run(capsys, "demo", "--out", str(tmp_path / "d"), "--json")
    assert code == 0 and json.loads(out)["people"] == 1
    folder, options = taken[0]
    assert (folder, options["out"], options["replace"]) == (demo_session, tmp_path / "d", False)
    assert "next: posefuse track SESSION --out RESULT" in err
    monkeypatch.setattr("posefuse.pipeline.session._PLACES", (tmp_path / "nowhere",))
    code, _, err = run(capsys, "demo")
    assert code == 1 and "reinstall posefuse" in err.splitlines()[-1]


def test_the_wheel_brings_the_clip_and_stays_small() -> None:
    root = Path(__file__).resolve().parents[2]
    content = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert set(content.values()) == {"posefuse/demo_clip/rig.toml", "posefuse/demo_clip/videos"}
    brought = [file for source in content for file in [root / source, *(root / source).glob("*")] if file.is_file()]
    assert sum(file.stat().st_size for file in brought) < 2_000_000


def test_models_can_be_checked_without_a_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    code, out, err = run(capsys, "models", "--check", "--json")
    assert {model["state"] for model in json.loads(out)["models"]} == {"missing"}
    assert code == 1 and "missing or damaged: " in err and "`posefuse models` fetches them" in err


@pytest.mark.parametrize(
    ("argv", "part"),
    [
        (["track", "nowhere", "--out", "x"], "no such session folder"),
        (["track", DEMO, "--out", "x", "--outputs", "fbx"], "no plug-in 'fbx' among outputs; there are: "),
        (["track", "nowhere", "--out", "x", "--set", "fuse.weights=best"], "'best'"),
        (["simulate", "none.yaml", "--out", "x"], "none.yaml: no such file"),
        (["simulate", "none.yaml", "--plan", "--workers", "2"], "--workers 2: goes with --out DIR only"),
        (["simulate", "none.yaml", "--plan", "--force"], "--force: goes with --out DIR or --gazebo DIR only"),
        (["view", "nowhere"], "nowhere"),
        (["track", "rig.toml", "--out", "x"], "rig.toml: is a file; expected a session folder"),
        (["simulate", "rig.toml", "--out", "x"], "rig.toml: this is another kind of file: expected keys among duration_s, "),
        (["models", "--accept-licence"], "--accept-licence: expected the names of the networks whose terms were read"),
        (["models", "rtmo_s", "--check", "--accept-licence"], "--accept-licence: expected a download, not --check"),
        (
            ["calibrate", "print", "--columns", "5", "--out", "a.pdf"],
            "calibrate print: target charuco: missing --rows N",
        ),
    ],
)
def test_a_known_error_is_one_line_and_exit_1(argv: list[str], part: str, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.toml").write_text("".join(f'[cam{i}]\nname = "cam{i}"\n' for i in range(4)), encoding="utf-8")
    code, out, err = run(capsys, *argv)
    assert code == 1
    assert out == ""
    assert part in err
    assert err.startswith("posefuse")
    assert len(err.strip().splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["rig.toml"]


def in_place_of_plugins(monkeypatch: pytest.MonkeyPatch, work: Callable[[], Figures]) -> None:
    def plugins(*, terminal: Shown) -> Figures:
        return work()

    monkeypatch.setattr(machine_commands, "plugins", plugins)


def test_a_bug_prints_a_trace_and_exits_2(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def broken() -> Figures:
        raise ZeroDivisionError("oops")

    in_place_of_plugins(monkeypatch, broken)
    code, _, err = run(capsys, "plugins")
    assert code == 2
    assert "Traceback" in err and "oops" in err and "bug in posefuse" in err


@pytest.mark.parametrize(("code", "reason"), [(errno.ENOSPC, "cannot be written"), (errno.EACCES, "cannot be opened")])
def test_what_the_machine_does_not_allow_is_one_line_and_exit_1(code: int, reason: str, monkeypatch, capsys) -> None:
    def refused() -> Figures:
        raise OSError(code, os.strerror(code), "session/videos")

    in_place_of_plugins(monkeypatch, refused)
    assert run(capsys, "plugins") == (1, "", f"posefuse plugins: session/videos: {reason} ({os.strerror(code)})\n")


@pytest.mark.parametrize("request_", [signal.SIGINT, *REQUESTS_TO_END])
def test_a_request_to_end_is_reported_and_exits_with_its_code(request_: signal.Signals, monkeypatch, capsys) -> None:
    before, name = signal.getsignal(request_), "Ctrl-C" if request_ == signal.SIGINT else request_.name
    in_place_of_plugins(monkeypatch, lambda: signal.raise_signal(request_) or {})
    assert run(capsys, "plugins")[::2] == (128 + request_, f"posefuse plugins: stopped by {name}\n")
    assert signal.getsignal(request_) is before


def test_one_request_that_arrives_twice_counts_once(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    """`timeout` sends it to the program and to its group; the second one may not end what the first one began."""
    finished: list[bool] = []

    def keeps() -> Figures:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            signal.raise_signal(signal.SIGTERM)
            finished.append(True)
            raise
        return {}

    in_place_of_plugins(monkeypatch, keeps)
    assert run(capsys, "plugins")[0] == 143
    assert finished == [True]


def test_outside_the_main_thread_it_runs_without_a_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    in_place_of_plugins(monkeypatch, dict)
    codes: list[int] = []
    thread = threading.Thread(target=lambda: codes.append(cli.main(["plugins"])))
    thread.start()
    thread.join(60)
    assert codes == [0]


def test_a_forked_child_ends_by_the_signal_as_any_program(capfd) -> None:
    if not hasattr(os, "fork"):
        pytest.skip("fork: needs a POSIX system")
    with terminate_on_signals():
        child = os.fork()
        if child == 0:
            signal.raise_signal(signal.SIGTERM)
            os._exit(0)
        _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGTERM
    assert capfd.readouterr().err == ""


def test_ctrl_c_while_importing_is_one_line() -> None:
    script = (
        "import builtins, sys\n"
        "from posefuse.cli import main as cli\n"
        "real = builtins.__import__\n"
        "def stopped(name, *args, **options):\n"
        "    if name == 'numpy':\n"
        "        raise KeyboardInterrupt\n"
        "    return real(name, *args, **options)\n"
        "assert 'numpy' not in sys.modules\n"
        "builtins.__import__ = stopped\n"
        "sys.exit(cli.main(['plugins']))\n"
    )
    done = python("-c", script)
    assert done.returncode == 130
    assert len(done.stderr.splitlines()) == 1 and "stopped by Ctrl-C" in done.stderr


def test_a_plugin_that_cannot_be_imported_is_listed_with_its_reason(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    from importlib.metadata import EntryPoint

    from posefuse.foundation import plugins

    broken = EntryPoint("broken", "posefuse_nowhere:Config", "posefuse.outputs")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [broken] if group == "posefuse.outputs" else [])
    listed = json.loads(run(capsys, "plugins", "--json")[1])["plugins"]
    assert listed[0]["name"] == "broken"
    assert "posefuse_nowhere" in listed[0]["reason"]
    refusal(DependencyError, "posefuse_nowhere", plugins.build_plugin, "outputs", "broken", {})


def test_help_and_version_work_as_a_program() -> None:
    shown = python("-m", "posefuse", "--help").stdout
    assert all(command in shown for command in cli.COMMANDS)
    assert python("-m", "posefuse", "--version").stdout.strip() == f"posefuse {__version__}"


def test_a_table_that_is_too_wide_has_narrow_cells_before_broken_words(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    columns = ("camera", "state", "used", "capture", "wait", "2D", "fuse", "output", "total", "p95", "p99")
    Terminal(as_json=False).show([Heading("Latency"), Table(columns, [("cam00", "ok", "58%", *["12.3"] * 6, "87", "127")])])
    header = capsys.readouterr().out.splitlines()[2]
    assert [word for word in columns if word not in header] == []


def test_numbers_of_one_column_have_one_number_of_digits(capsys, read_page, tmp_path: Path) -> None:
    columns, rows = ("camera", "sigmas"), [("cam00", 0.88), ("cam01", 0.879), ("cam02", 12.0), ("cam03", float("nan"))]
    Terminal(as_json=False).show([Heading("Cameras"), Table(columns, rows)])
    on_a_page = read_page(write_page(tmp_path / "page.html", Page("title", [Table(columns, rows[:2])]))).tables[0]
    assert re.findall(r"cam0\d\W+?(\d+\.\d+|–) ", capsys.readouterr().out) == ["0.9", "0.9", "12.0", "–"]
    assert [row[1] for row in on_a_page[1:]] == ["0.880", "0.879"]


def test_a_session_that_was_stopped_before_it_began_has_no_figures_of_nothing(capsys) -> None:
    nan = float("nan")
    no_time = {"p50": nan, "p95": nan, "p99": nan}
    latency = {
        "cameras_ms": {"cam00": dict.fromkeys(STAGES, no_time)},
        "all_cameras_total_ms": no_time,
        "output": {"behind_due_ms": no_time, "period_deviation_ms": no_time, "skipped": 0},
    }
    figures = {
        "latency": latency, "cameras": {"cam00": {"state": "opening", "captured": 0, "used_share": nan}}, "poses": 0,
        "poses_per_s": nan, "poses_with_people": 0, "withheld": {}, "joint_centres": {}, "noise_scale": None, "used_share": nan,
        "restarts": 0, "outputs": {}, "outputs_lost": 0, "rig_watch_trouble": "", "cpu_fusion_share": nan,
        "cpu_children_share": nan, "memory_mb": nan,
    }  # fmt: skip
    Terminal(as_json=False).show(live_summary(figures))
    out = capsys.readouterr().out
    assert "nan" not in out and "0 (–/s), with a person in 0" in out


@pytest.mark.parametrize("request_", ["SIGINT", "SIGTERM"])
def test_a_request_to_end_that_comes_in_a_destructor_is_neither_printed_nor_lost(request_: str, capsys) -> None:
    class Asked:
        def __del__(self) -> None:
            signal.raise_signal(signal.Signals[request_])

    with terminate_on_signals(), pytest.raises(KeyboardInterrupt):
        asked = Asked()
        del asked
        time.sleep(30)
    assert capsys.readouterr().err == ""


KERNEL = """
import numba

@numba.njit(cache=True)
def twice(x):
    return 2 * x
"""
LOAD = """
import signal
from numba.core import codegen
from posefuse.cli.stopping import terminate_on_signals

hook = codegen.CPUCodeLibrary._object_getbuffer_hook

def asked(cls, library):
    signal.raise_signal(signal.SIGTERM)
    return hook(library)

codegen.CPUCodeLibrary._object_getbuffer_hook = classmethod(asked)
with terminate_on_signals():
    try:
        from kernel import twice
        print(twice(2.0))
        import time
        time.sleep(30)
    except KeyboardInterrupt:
        print("stopped")
"""


def test_a_request_to_end_that_comes_while_a_compiled_kernel_is_loaded_does_not_crash(tmp_path: Path) -> None:
    """LLVM asks Python for the machine code; an exception there leaves it without, and it would jump to nowhere."""
    (tmp_path / "kernel.py").write_text(KERNEL)
    for code in ("import kernel; kernel.twice(2.0)", LOAD):
        done = python("-c", code, PYTHONPATH=f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "stopped"


@pytest.mark.parametrize(
    ("line", "package", "extra"),
    [
        ("live {rig} {sources} --record {new}/a.mcap", "mcap.writer", "ros"),
        ("live {rig} {sources} --output lsl", "pylsl", "lsl"),
        ("live {rig} {sources} --view", "rerun", "viewer"),
        ("live {rig} {sources} --ros", "cyclonedds._clayer", "ros"),
        ("track {demo} --out {new}/r --outputs mcap", "mcap.writer", "ros"),
        ("track {demo} --out {new}/r --outputs rerun", "rerun", "viewer"),
    ],
)
def test_what_needs_an_extra_is_refused_before_any_work(
    line: str, package: str, extra: str, tmp_path: Path, demo_session: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    def work(*_: object) -> None:
        raise AssertionError("began to work")

    monkeypatch.setitem(sys.modules, package, None)
    live, recorded = "posefuse.api.live_run", "posefuse.detection.build"
    for place in (f"{live}.fetch_networks", f"{live}.run_live", f"{recorded}.fetch_networks"):
        monkeypatch.setattr(place, work)
    sources = " ".join(f"--source cam0{i}=video:{demo_session}/videos/cam0{i}.mp4" for i in range(4))
    words = line.format(rig=demo_session / "rig.toml", demo=demo_session, sources=sources, new=tmp_path)
    code, _, err = run(capsys, *words.split())
    assert code == 1 and f"posefuse[{extra}]" in err.splitlines()[-1] and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("`resume=True` continues, `replace=True` begins", "--resume continues, --force begins"),
        ("add `rate_hz=HZ`, or `clocks=offset`", "add --rate HZ, or --clocks offset"),
        ("try `drift=True`; `max_offset_s=60`", "try --clocks drift; --most-s 60"),
        ("`posefuse models` fetches them; `.mcap`", "`posefuse models` fetches them; `.mcap`"),
    ],
)
def test_arguments_of_python_are_options_of_the_command_line(text: str, shown: str, capsys) -> None:
    Terminal(False).warn(text)
    assert shown in capsys.readouterr().err


def test_every_argument_that_a_message_names_is_an_option() -> None:
    """Each translation ends in an option that some command has."""
    app = application()
    places = [app[name][step] for name, steps in STEPS.items() for step in steps]
    places += [app[name] for name in COMMANDS if name not in STEPS]
    names = {name for place in places for one in place.assemble_argument_collection() for name in one.names}
    options = {name.removeprefix("--").replace("-", "_") for name in names}
    texts = [path.read_text() for path in Path(posefuse.__file__).parent.rglob("*.py") if "cli" not in path.parts]
    named = {name for text in texts for name in re.findall(r'(?<!")"(?!")[^"\n]*`([a-z_]+)=[^`"\n]*`', text)}
    shown = {in_options(f"`{name}=True`").removeprefix("--").split()[0].replace("-", "_") for name in named}
    assert {"rate", "force", "clocks"} <= shown <= options

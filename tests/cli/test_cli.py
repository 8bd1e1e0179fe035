"""The command line: figures as JSON on stdout and nothing else there, one line and exit 1 for a known error, 2 for a bug."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from posefuse import __version__
from posefuse.cli import main as cli
from posefuse.cli.commands import plugins as plugins_command
from posefuse.core import DependencyError


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    try:
        code = cli.main(list(argv))
    except SystemExit as left:
        code = int(left.code or 0)
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("command", ["plugins", "doctor"])
def test_json_is_alone_on_stdout_and_says_what_the_table_says(command: str, capsys) -> None:
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
    assert not checks["display"]["needed"]
    assert all(check["ok"] or check["cure"] for check in checks.values())


def test_models_can_be_checked_without_a_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path))
    models = json.loads(run(capsys, "models", "--check", "--json")[1])["models"]
    assert {model["state"] for model in models} == {"missing"}
    code, _, err = run(capsys, "models", "--from", str(tmp_path / "none.whl"))
    assert code == 1
    assert "none.whl" in err.splitlines()[-1]


@pytest.mark.parametrize(
    ("argv", "part"),
    [
        (["frobnicate"], "invalid choice: 'frobnicate'"),
        (["track"], "required: SESSION, --out"),
        (["track", "nowhere", "--out", "x"], "no such session folder"),
        (["track", "nowhere", "--out", "x", "--person", "here"], "expected X,Y in metres"),
        (["track", "nowhere", "--out", "x", "--outputs", "fbx"], "no plug-in 'fbx' among sinks; there are: "),
        (["track", "nowhere", "--out", "x", "--set", "fuse.weights=best"], "'best'"),
        (["simulate", "none.yaml", "--out", "x"], "none.yaml"),
        (["view", "nowhere"], "nowhere"),
    ],
)
def test_a_known_error_is_one_line_and_exit_1(
    argv: list[str], part: str, capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = run(capsys, *argv)
    assert code == 1
    assert out == ""
    assert part in err
    assert err.startswith("posefuse")
    assert len(err.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_a_bug_prints_a_trace_and_exits_2(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def broken(args: object, terminal: object) -> None:
        raise ZeroDivisionError("oops")

    monkeypatch.setattr(plugins_command, "run", broken)
    code, _, err = run(capsys, "plugins")
    assert code == 2
    assert "Traceback" in err and "oops" in err and "bug in posefuse" in err


def test_ctrl_c_is_said_and_exits_130(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    def stopped(args: object, terminal: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(plugins_command, "run", stopped)
    assert run(capsys, "plugins")[::2] == (130, "posefuse plugins: stopped by Ctrl-C\n")


def test_a_plugin_that_cannot_be_imported_is_listed_with_its_reason(monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    from importlib.metadata import EntryPoint

    from posefuse.foundation import plugins

    broken = EntryPoint("broken", "posefuse_nowhere:Config", "posefuse.outputs")
    monkeypatch.setattr(plugins, "entry_points", lambda group: [broken] if group == "posefuse.outputs" else [])
    listed = json.loads(run(capsys, "plugins", "--json")[1])["plugins"]
    assert listed[0]["name"] == "broken"
    assert "posefuse_nowhere" in listed[0]["reason"]
    with pytest.raises(DependencyError, match="posefuse_nowhere"):
        plugins.build_plugin("sinks", "broken", {})


def test_help_and_version_work_as_a_program() -> None:
    helped = subprocess.run([sys.executable, "-m", "posefuse.cli.main", "--help"], capture_output=True, text=True, check=True)
    assert all(command in helped.stdout for command in cli.COMMANDS)
    version = subprocess.run([sys.executable, "-m", "posefuse.cli.main", "--version"], capture_output=True, text=True, check=True)
    assert version.stdout.strip() == f"posefuse {__version__}"

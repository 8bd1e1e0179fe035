"""Names of folders and files may have letters of all languages, spaces and brackets, in every command that takes them."""

import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from commands import as_options
from studies import SETTINGS, write_session

from posefuse.cli.main import main
from posefuse.core import Rig
from posefuse.formats.rig import write_rig


@pytest.mark.parametrize("name", ["Käthe Müller [red] (a)", "a b's #1 走 100%"])
def test_a_name_of_any_letters_works_in_every_command(
    name: str, tmp_path: Path, ring_rig: Callable[..., Rig], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    study, rig = tmp_path / name, ring_rig(3)
    session = study / "P01" / name
    write_session(session, rig)
    write_rig(session / "rig.toml", rig)
    result, other = tmp_path / f"{name} result", tmp_path / f"{name} other"
    settings = as_options(SETTINGS)
    commands = {
        "track": (session, "--out", result, "--names", name, "--outputs", "trc,csv,overview", *settings),
        "again": (result, "--out", other),
        "export": (result, "--out", tmp_path / f"{name} files", "--outputs", "c3d,trc"),
        "compare": (result, other, "--out", tmp_path / f"{name} comparison"),
        "report": (result, "--fit", "none", "--title", name),
        "batch": (study, "--out", tmp_path / f"{name} study", "--no-report", "--jobs", "1", *settings),
    }
    for command, words in commands.items():
        assert main(["solve" if command == "again" else command, *map(str, words)]) == 0, (command, capsys.readouterr().err)
        shown = capsys.readouterr()
        assert name in shown.out + shown.err, command
        for line in (one for one in (shown.out + shown.err).splitlines() if one.startswith("next: posefuse ")):
            typed = shlex.split(line.removeprefix("next: ").partition("  (")[0])
            assert all(Path(word).exists() for word in typed if word.startswith(str(tmp_path))), line
    assert name in (result / "biomechanics" / "report.html").read_text(encoding="utf-8").replace("&#39;", "'")
    board = tmp_path / f"{name}.pdf"
    assert main(["calibrate", "print", "--cube", "--marker-mm", "60", "--out", str(board)]) == 0 and board.is_file()
    shutil.copy(session / "rig.toml", tmp_path / f"{name}.toml")
    assert main(["track", str(session), "--rig", str(tmp_path / f"{name}.toml"), "--out", str(other), "--force", *settings]) == 0

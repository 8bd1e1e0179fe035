"""Every script of bench/ can be imported: the names that it takes from posefuse and from other scripts are there."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted(path.stem for path in (ROOT / "bench").glob("*.py"))
# one process imports all; a package that an extra brings may be missing, one of ours may not
IMPORT_ALL = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name.partition(".")[0] in ("posefuse", "paper", "bench", *sys.argv[1:]):
            print(name, error)
    except ImportError as error:
        print(name, error)
"""


def problems(folder: Path, scripts: list[str]) -> str:
    place = f"import sys; sys.path[:0] = [{str(folder)!r}, {str(ROOT)!r}]\n"
    done = subprocess.run(
        [sys.executable, "-c", place + IMPORT_ALL, *scripts], capture_output=True, text=True, timeout=300, check=True
    )
    return done.stdout


def test_every_script_finds_what_it_imports() -> None:
    assert len(SCRIPTS) > 50
    assert problems(ROOT / "bench", SCRIPTS) == ""


def test_the_check_can_fail(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("from two import gone\n")
    (tmp_path / "two.py").write_text("import posefuse.nowhere\n")
    (tmp_path / "three.py").write_text("from posefuse.core import gone\n")
    found = problems(tmp_path, ["one", "two", "three"])
    assert "No module named 'posefuse.nowhere'" in found and "three cannot import name 'gone'" in found

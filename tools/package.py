"""What would be published, checked: python tools/package.py [--python PYTHON ...] [--minutes N] [--write PAGE] [--no-install]

Builds the source distribution and the wheel into dist/, lets twine check both, and checks the size of the wheel. Installs the
wheel into empty environments of each Python that is here, without constraints: once with the newest version of every package that
there is today, once with the lowest that pyproject.toml allows. Runs the commands of a first hour in each, and prints a table.
Uploads nothing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from page_marks import between_marks, write_between_marks

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
PYTHONS = ("3.11", "3.12", "3.13")
# a third of it is the clip of `demo`; weights or a second clip, packed by mistake, are far beyond
MOST_WHEEL_BYTES = 3_500_000
# uv's names; pip can take the newest only
RESOLUTIONS = {"newest": "highest", "lowest": "lowest-direct"}
COMMANDS = ("demo", "report", "live", "print", "calibrate")
BOARD = ("--columns", "5", "--rows", "7", "--square-mm", "30", "--marker-mm", "22")


def main() -> None:
    """Build, check, try."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="append", help="Python to try it with (default: those of 3.11 to 3.13 that are here)")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no installation later than this")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the rows into the table of this page")
    parser.add_argument("--no-install", action="store_true", help="build and check only")
    options = parser.parse_args()
    wheel = build()
    if not options.no_install:
        rows = try_everywhere(wheel, options.python or present_pythons(), options.minutes)
        print(f"\n{table(rows)}")
        if options.write:
            write(options.write, rows)
        if failed := [row for row in rows if any("failed" in cell for cell in row)]:
            raise SystemExit(f"{len(failed)} of {len(rows)} installations do not work")


def build() -> Path:
    """The wheel, with everything checked that can be checked without installing it."""
    with tempfile.TemporaryDirectory() as new:
        run([sys.executable, "-m", "build", "--outdir", new, str(ROOT)])
        made = sorted(Path(new).iterdir())
        run([sys.executable, "-m", "twine", "check", "--strict", *map(str, made)])
        DIST.mkdir(exist_ok=True)
        paths = [Path(shutil.copy(path, DIST / path.name)) for path in made]
    for path in paths:
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    wheel = next(path for path in paths if path.suffix == ".whl")
    if wheel.stat().st_size > MOST_WHEEL_BYTES:
        raise SystemExit(f"{wheel.name}: expected at most {MOST_WHEEL_BYTES / 1e6:g} MB")
    return wheel


def present_pythons() -> list[str]:
    """Those of `PYTHONS` that are on the path or that pyenv keeps."""
    found = {version: next(_working(version), None) for version in PYTHONS}
    missing = [version for version, path in found.items() if path is None]
    if missing:
        print(f"not tried, because not on this machine: Python {', '.join(missing)}")
    return [path for path in found.values() if path is not None]


def _working(version: str) -> Iterator[str]:
    """Paths of that Python; a stand-in of a version manager that has no such Python does not count."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for path in (shutil.which(f"python{version}"), *map(str, sorted(kept.glob(f"{version}.*/bin/python")))):
        if path and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0:
            yield path


def try_everywhere(wheel: Path, pythons: list[str], minutes: float = float("inf")) -> list[list[str]]:
    """Try the wheel with every Python and both choices of versions, as far as the time reaches; rows of the table."""
    end_s = time.monotonic() + 60 * minutes
    rows = []
    for chosen in RESOLUTIONS:
        for python in pythons:
            if time.monotonic() < end_s:
                rows.append(try_installed(wheel, python, chosen))
            else:
                print(f"not tried, because the {minutes:g} minutes are over: {python}, {chosen} versions")
    return rows


def table(rows: list[list[str]]) -> str:
    """The rows as Markdown."""
    head = [["Python", "versions", "MB installed", *COMMANDS], ["---"] * (3 + len(COMMANDS))]
    return "\n".join(f"| {' | '.join(row)} |" for row in (*head, *rows))


def write(page: Path, rows: list[list[str]]) -> None:
    """Put rows between the marks of a page; those of other Pythons and choices, from earlier runs, stay."""
    _, middle, _ = between_marks(page, "package")
    known = [[cell.strip() for cell in line.strip("|").split("|")] for line in middle.splitlines()[2:]]
    merged = {tuple(row[:2]): row for row in (*known, *rows)}
    ordered = sorted(merged.values(), key=lambda row: (row[0], list(RESOLUTIONS).index(row[1])))
    write_between_marks(page, table(ordered), "package")


def try_installed(wheel: Path, python: str, chosen: str) -> list[str]:
    """Install the wheel into an empty environment and run the commands of a first hour there; a row of the table."""
    with tempfile.TemporaryDirectory() as place:
        environment = Path(place) / "venv"
        uv = [sys.executable, "-m", "uv"]
        run([*uv, "venv", "--quiet", "--python", python, str(environment)])
        scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
        # a version without a wheel is passed over, as by a user without a compiler; "direct" are the project's own dependencies
        wanted = ["--requirements", str(ROOT / "pyproject.toml"), str(wheel)]
        chosen_by = ["--only-binary", ":all:", "--resolution", RESOLUTIONS[chosen]]
        run([*uv, "pip", "install", "--quiet", "--python", str(environment), *chosen_by, *wanted])
        megabytes = sum(path.stat().st_size for path in environment.rglob("*") if path.is_file() and not path.is_symlink()) / 1e6
        version = subprocess.check_output(
            [scripts / "python", "-c", "import platform; print(platform.python_version())"], text=True
        )
        results = [_outcome(scripts, words, Path(place)) for words in _commands(environment, Path(place))]
        return [version.strip(), chosen, f"{megabytes:.0f}", *results]


def _commands(environment: Path, place: Path) -> Iterator[list[str]]:
    """Words of the commands in `COMMANDS`, and what each needs."""
    [clip] = environment.rglob("posefuse/demo_clip")
    videos = [f"--source={path.stem}=video:{path}" for path in sorted((clip / "videos").iterdir())]
    yield ["demo", "--out", "result"]
    yield ["report", "result"]
    yield ["live", str(clip / "rig.toml"), *videos, "--duration", "5"]
    yield ["calibrate", "print", "--target", "charuco", *BOARD, "--out", "board.pdf"]
    yield ["calibrate", "intrinsics", str(place / "board"), "--target", "board.toml", "--out", "lenses.toml"]


def _outcome(scripts: Path, words: list[str], place: Path) -> str:
    if "intrinsics" in words:
        run([str(scripts / "python"), str(ROOT / "tools" / "board_views.py"), str(place / "board")])
    begun_s = time.monotonic()
    done = subprocess.run([scripts / "posefuse", *words], cwd=place, check=False)
    return "failed" if done.returncode else f"{time.monotonic() - begun_s:.0f} s"


def run(command: list[str]) -> None:
    """Run a command; its failure ends the program."""
    done = subprocess.run(command, check=False)
    if done.returncode:
        raise SystemExit(f"failed with status {done.returncode}: {' '.join(command)}")


if __name__ == "__main__":
    main()

"""What would be published, checked: python tools/package.py [--python PYTHON ...] [--write PAGE] [--no-install]

Builds the source distribution and the wheel of posefuse and of each package below packages/ into dist/, lets twine check them,
and checks the size of the wheel of posefuse. Installs it into empty environments of each Python that is here, without
constraints: once with the newest version of every package that there is today, once with the lowest that pyproject.toml allows.
Runs the commands of a first hour in each; then adds the wheels of the other packages, runs a command of each, and prints two
tables. Uploads nothing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from itertools import product
from pathlib import Path

from page_marks import between_marks, markdown, write_between_marks

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
PYTHONS = ("3.11", "3.12", "3.13")
# a third of it is the clip of `demo`; weights or a second clip, packed by mistake, are far beyond
MOST_WHEEL_BYTES = 3_500_000
# uv's names; pip can take the newest only
RESOLUTIONS = {"newest": "highest", "lowest": "lowest-direct"}
COMMANDS = ("demo", "report", "live", "print", "calibrate")
# what is tried of each package below packages/
PACKAGES = {
    "posefuse-ros": "live --record",
    "posefuse-sim": "simulate --plan",
    "posefuse-studio": "studio",
    "posefuse-teleop": "teleoperate",
}
COLUMNS = {
    "package": ("Python", "versions", "MB installed", *COMMANDS),
    "packages": ("Python", "versions", "MB installed", *PACKAGES.values()),
}
STUDIO = "http://127.0.0.1:8799/"
PATIENCE_S = 600.0
BOARD = ("--columns", "5", "--rows", "7", "--square-mm", "30", "--marker-mm", "22")


def main() -> None:
    """Build, check, try."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="append", help="Python to try it with (default: those of 3.11 to 3.13 that are here)")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the rows into the table of this page")
    parser.add_argument("--no-install", action="store_true", help="build and check only")
    options = parser.parse_args()
    wheels = build()
    if not options.no_install:
        tried = [try_installed(wheels, *one) for one in product(options.python or present_pythons(), RESOLUTIONS)]
        for name, columns in COLUMNS.items():
            rows = [found[name] for found in tried]
            print(f"\n{markdown(columns, rows)}")
            if options.write:
                write(options.write, name, rows)
        every = [row for found in tried for row in found.values()]
        if failed := [row for row in every if "failed" in row]:
            raise SystemExit(f"{len(failed)} of {len(every)} installations do not work")


def build() -> list[Path]:
    """The wheels, that of posefuse first, with everything checked that can be checked without installing them."""
    with tempfile.TemporaryDirectory() as new:
        for project in (ROOT, *sorted(ROOT.glob("packages/*"))):
            run([sys.executable, "-m", "build", "--outdir", new, str(project)])
        made = sorted(Path(new).iterdir())
        run([sys.executable, "-m", "twine", "check", "--strict", *map(str, made)])
        DIST.mkdir(exist_ok=True)
        paths = [Path(shutil.copy(path, DIST / path.name)) for path in made]
    for path in paths:
        print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    wheels = sorted((path for path in paths if path.suffix == ".whl"), key=lambda path: len(path.name))
    if wheels[0].stat().st_size > MOST_WHEEL_BYTES:
        raise SystemExit(f"{wheels[0].name}: expected at most {MOST_WHEEL_BYTES / 1e6:g} MB")
    return wheels


def present_pythons() -> list[str]:
    """Those of `PYTHONS` that uv finds on the path, or among those that pyenv keeps."""
    find = [sys.executable, "-m", "uv", "python", "find", "--system", "--no-python-downloads"]
    # before the stand-ins of pyenv, which are there for versions that it has not chosen
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob("versions/*/bin")
    place = os.environ | {"PATH": os.pathsep.join([*map(str, kept), os.environ["PATH"]])}
    found = {version: subprocess.run([*find, version], env=place, capture_output=True, text=True) for version in PYTHONS}
    if missing := [version for version, done in found.items() if done.returncode]:
        print(f"not tried, because not on this machine: Python {', '.join(missing)}")
    return [done.stdout.strip() for done in found.values() if not done.returncode]


def write(page: Path, name: str, rows: list[list[str]]) -> None:
    """Put rows between the marks of a page; those of other Pythons and choices, from earlier runs of the same columns, stay."""
    _, middle, _ = between_marks(page, name)
    known = [[cell.strip() for cell in line.strip("|").split("|")] for line in middle.splitlines()]
    stay = known[2:] if known and tuple(known[0]) == COLUMNS[name] else []
    merged = {tuple(row[:2]): row for row in (*stay, *rows)}
    ordered = sorted(merged.values(), key=lambda row: (row[0], list(RESOLUTIONS).index(row[1])))
    write_between_marks(page, markdown(COLUMNS[name], ordered), name)


def try_installed(wheels: list[Path], python: str, chosen: str) -> dict[str, list[str]]:
    """Install the wheels into an empty environment and run the commands of a first hour there; a row of each table."""
    with tempfile.TemporaryDirectory() as folder:
        place, environment = Path(folder), Path(folder) / "venv"
        uv = [sys.executable, "-m", "uv"]
        run([*uv, "venv", "--quiet", "--python", python, str(environment)])
        # a version without a wheel is passed over, as by a user without a compiler; "direct" are the projects' own dependencies
        install = [
            *uv, "pip", "install", "--quiet", "--python", str(environment), "--only-binary", ":all:",
            "--resolution", RESOLUTIONS[chosen], "--requirements", str(ROOT / "pyproject.toml"),
        ]  # fmt: skip
        scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
        run([*install, str(wheels[0])])
        version = subprocess.check_output(
            [scripts / "python", "-c", "import platform; print(platform.python_version())"], text=True
        ).strip()
        core = [_outcome(scripts, words, place) for words in _commands(environment, place)]
        megabytes = _megabytes(environment)
        required = [f"--requirements={ROOT / 'packages' / name / 'pyproject.toml'}" for name in PACKAGES]
        added = subprocess.run([*install, *required, *map(str, wheels)], check=False)
        more = ["failed" if added.returncode else _package_works(name, scripts, place) for name in PACKAGES]
        return {
            "package": [version, chosen, megabytes, *core],
            "packages": [version, chosen, _megabytes(environment), *more],
        }


def _megabytes(folder: Path) -> str:
    return f"{sum(path.stat().st_size for path in folder.rglob('*') if path.is_file() and not path.is_symlink()) / 1e6:.0f}"


def _commands(environment: Path, place: Path) -> Iterator[list[str]]:
    """Words of the commands in `COMMANDS`, and what each needs."""
    yield ["demo", "--out", "result"]
    yield ["report", "result"]
    yield ["live", *_clip(environment), "--duration", "5"]
    yield ["calibrate", "print", "--target", "charuco", *BOARD, "--out", "board.pdf"]
    yield ["calibrate", "intrinsics", str(place / "board"), "--target", "board.toml", "--out", "lenses.toml"]


def _package_works(name: str, scripts: Path, place: Path) -> str:
    if name == "posefuse-studio":
        return _page_answers(scripts, place)
    if name == "posefuse-sim":
        return _outcome(scripts, ["simulate", str(ROOT / "examples" / "scenes" / "walk_4cam.yaml"), "--plan"], place)
    if name == "posefuse-ros":
        return _outcome(scripts, ["live", *_clip(place / "venv"), "--record", "live.mcap", "--duration", "5"], place)
    return _outcome(scripts, ["teleoperate", *_clip(place / "venv"), "--deadman", "web:8798", "--duration", "5"], place)


def _clip(environment: Path) -> list[str]:
    [clip] = environment.rglob("posefuse/demo_clip")
    return [str(clip / "rig.toml"), *(f"--source={path.stem}=video:{path}" for path in sorted((clip / "videos").iterdir()))]


def _page_answers(scripts: Path, place: Path) -> str:
    """How long the studio takes until its page answers; it is then ended as by Ctrl-C."""
    begun_s = time.monotonic()
    port = STUDIO.rstrip("/").rpartition(":")[2]
    studio = subprocess.Popen([scripts / "posefuse", "studio", str(place), "--port", port, "--no-open"], cwd=place)
    try:
        while studio.poll() is None and time.monotonic() < begun_s + PATIENCE_S:
            try:
                urllib.request.urlopen(STUDIO, timeout=10).close()
                return f"{time.monotonic() - begun_s:.0f} s"
            except urllib.error.HTTPError:
                # it asks for its token
                return f"{time.monotonic() - begun_s:.0f} s"
            except OSError:
                time.sleep(0.5)
        return "failed"
    finally:
        studio.send_signal(signal.SIGINT)
        studio.wait(PATIENCE_S)


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

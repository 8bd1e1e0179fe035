"""What would be published, checked: python tools/package.py [--python PYTHON ...] [--no-install]

Builds the source distribution and the wheel into dist/, lets twine check both, checks the size of the wheel, and installs it into
an empty environment of each Python that is here, where it runs `posefuse demo` and writes the report. Uploads nothing.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
PYTHONS = ("3.11", "3.12", "3.13")
MOST_WHEEL_BYTES = 3_000_000


def main() -> None:
    """Build, check, try."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", action="append", help="Python to try it with (default: those of 3.11 to 3.13 that are here)")
    parser.add_argument("--no-install", action="store_true", help="build and check only")
    options = parser.parse_args()
    wheel = build()
    if not options.no_install:
        for python in options.python or present_pythons():
            try_installed(wheel, python)


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
    """Those of `PYTHONS` on the path, and the one that runs this."""
    here = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = {version: sys.executable if version == here else _working(f"python{version}") for version in PYTHONS}
    missing = [version for version, path in found.items() if path is None]
    if missing:
        print(f"not tried, because not on this machine: Python {', '.join(missing)}")
    return [path for path in found.values() if path is not None]


def _working(name: str) -> str | None:
    """Its path; None also for a stand-in of a version manager that has no such Python."""
    path = shutil.which(name)
    return path if path and subprocess.run([path, "--version"], capture_output=True, check=False).returncode == 0 else None


def try_installed(wheel: Path, python: str) -> None:
    """Install the wheel with its dependencies into an empty environment and run the demo there."""
    with tempfile.TemporaryDirectory() as place:
        environment = Path(place) / "venv"
        if python == sys.executable:
            venv.create(environment, with_pip=True)
        else:
            run([python, "-m", "venv", str(environment)])
        scripts = environment / ("Scripts" if sys.platform == "win32" else "bin")
        run(
            [
                str(scripts / "python"),
                "-m",
                "pip",
                "install",
                "--quiet",
                "--constraint",
                str(ROOT / "constraints.txt"),
                str(wheel),
            ]
        )
        result = Path(place) / "result"
        run([str(scripts / "posefuse"), "demo", "--out", str(result)], cwd=place)
        run([str(scripts / "posefuse"), "report", str(result)], cwd=place)
        if not (result / "biomechanics" / "report.html").is_file():
            raise SystemExit(f"{python}: the demo wrote no report")
        print(f"{python}: installed into an empty environment; the demo and its report run")


def run(command: list[str], cwd: str | None = None) -> None:
    """Run a command; its failure ends the program."""
    done = subprocess.run(command, cwd=cwd, check=False)
    if done.returncode:
        raise SystemExit(f"failed with status {done.returncode}: {' '.join(command)}")


if __name__ == "__main__":
    main()

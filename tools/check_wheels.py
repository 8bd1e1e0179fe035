"""Which parts can be installed on which system without a compiler: python tools/check_wheels.py [--write PAGE]

Asks uv to resolve the core and each extra from wheels alone, for each system and Python below; nothing is installed.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

from package import PYTHONS, ROOT
from page_marks import markdown, write_between_marks

SYSTEMS = {
    "Linux x86-64": "x86_64-manylinux_2_28",
    "Windows x86-64": "x86_64-pc-windows-msvc",
    "macOS 14 arm64": "aarch64-apple-darwin",
}
# what its users install, of the extras in pyproject.toml
LEFT_OUT = ("docs", "publish", "mutation", "dev")


def main() -> None:
    """Print the table, or put it into a page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table between the marks of this page")
    options = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    parts = ["core", *(extra for extra in project["optional-dependencies"] if extra not in LEFT_OUT)]
    with ThreadPoolExecutor(4) as pool:
        cells = dict(pool.map(lambda one: (one, cell(*one)), product(parts, SYSTEMS)))
    text = markdown(["part", *SYSTEMS], ([part, *(cells[part, system] for system in SYSTEMS)] for part in parts))
    print(text)
    if options.write:
        write_between_marks(options.write, text, "wheels")


def cell(part: str, system: str) -> str:
    """What the table states of one part on one system."""
    lacking = {python: reason for python in PYTHONS if (reason := missing(part, system, python))}
    if not lacking:
        return "yes"
    where = "" if len(lacking) == len(PYTHONS) else f" ({', '.join(lacking)})"
    return f"no wheel: {', '.join(sorted(set(lacking.values())))}{where}"


def missing(part: str, system: str, python: str) -> str:
    """The package that has no wheel; empty where all have one."""
    extra = [] if part == "core" else ["--extra", part]
    command = [
        sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-python-downloads", "--only-binary", ":all:",
        "--python-version", python, "--python-platform", SYSTEMS[system], str(ROOT / "pyproject.toml"), *extra,
    ]  # fmt: skip
    environment = os.environ | {"MACOSX_DEPLOYMENT_TARGET": "14.0"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return ""
    named = re.search(r"Wheels are (?:required|available) for `([\w.-]+)`", done.stderr)
    return named[1] if named else "?"


if __name__ == "__main__":
    main()

"""Which packages have a wheel for which system: python tools/check_wheels.py [--extra NAME ...] [--markdown FILE]

Asks pip (`--dry-run`: nothing is installed) for every package that the core or an extra needs, in the version of
constraints.txt where it has one there, for each system and Python below. A package that comes as source only has no wheel.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13")
# a name for the table, and the platform tags pip may choose from
SYSTEMS = {
    "Linux x86-64": ("manylinux_2_28_x86_64", "manylinux_2_17_x86_64", "manylinux2014_x86_64", "manylinux_2_34_x86_64"),
    "Windows x86-64": ("win_amd64",),
    "macOS 11 arm64": ("macosx_11_0_arm64",),
    "macOS 14 arm64": ("macosx_14_0_arm64",),
}
# what a marker of a dependency is evaluated with
MARKERS = {
    "Linux x86-64": {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "platform_machine": "x86_64"},
    "Windows x86-64": {"sys_platform": "win32", "platform_system": "Windows", "os_name": "nt", "platform_machine": "AMD64"},
    "macOS 11 arm64": {"sys_platform": "darwin", "platform_system": "Darwin", "os_name": "posix", "platform_machine": "arm64"},
    "macOS 14 arm64": {"sys_platform": "darwin", "platform_system": "Darwin", "os_name": "posix", "platform_machine": "arm64"},
}
_AT_ONCE = 4
_LIMIT_S = 600


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; 1 when a package of the core lacks a wheel."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--extra", action="append", help="only these groups (core, or an extra of pyproject.toml)")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table there too")
    args = parser.parse_args(argv)
    groups = {name: found for name, found in _groups().items() if not args.extra or name in args.extra}
    pins = _pins()
    wanted = sorted({(name, system) for found in groups.values() for system, names in found.items() for name in names})
    asked = [(name, system, python) for name, system in wanted for python in PYTHONS]
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        there = dict(zip(asked, pool.map(lambda one: _has_wheel(pins.get(one[0], one[0]), *one[1:]), asked), strict=True))
    lines = list(_table(groups, there))
    print("\n".join(lines))
    if args.markdown:
        args.markdown.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return int(any(not ok for (name, system, _), ok in there.items() if name in groups.get("core", {}).get(system, ())))


def _table(groups: dict[str, dict[str, set[str]]], there: dict[tuple[str, str, str], bool]) -> Iterator[str]:
    yield "| part | " + " | ".join(SYSTEMS) + " |"
    yield "|---|" + "---|" * len(SYSTEMS)
    for group, found in groups.items():
        cells = []
        for system in SYSTEMS:
            lacking = {name: [python for python in PYTHONS if not there[name, system, python]] for name in sorted(found[system])}
            missing = [name + ("" if len(p) == len(PYTHONS) else f" ({', '.join(p)})") for name, p in lacking.items() if p]
            cells.append(f"no wheel: {', '.join(missing)}" if missing else f"all {len(found[system])}")
        yield f"| {group} | " + " | ".join(cells) + " |"


def _groups() -> dict[str, dict[str, set[str]]]:
    """Per group (core, extras) and system: the packages it needs beyond the core's, dependencies of dependencies included."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    core = {system: _closure(project["dependencies"], system) for system in SYSTEMS}
    groups = {"core": core}
    for extra, wanted in project["optional-dependencies"].items():
        groups[extra] = {system: _closure(wanted, system) - core[system] for system in SYSTEMS}
    return groups


def _closure(wanted: Sequence[str], system: str) -> set[str]:
    found: set[str] = set()
    todo = [Requirement(one) for one in wanted]
    while todo:
        one = todo.pop()
        # linked to an extra: only with one that was asked for
        contexts = [{**MARKERS[system], "extra": extra} for extra in (one.extras or {""})]
        name = canonicalize_name(one.name)
        if name in found:
            continue
        found.add(name)
        try:
            needs = [Requirement(text) for text in requires(name) or []]
        except PackageNotFoundError:
            continue
        todo += [need for need in needs if need.marker is None or any(need.marker.evaluate(context) for context in contexts)]
    return found


def _pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line.split("#")[0].strip() for line in lines if "==" in line]
    return {canonicalize_name(re.split("==", line)[0]): line for line in pinned}


def _has_wheel(pin: str, system: str, python: str) -> bool:
    tags = [option for tag in SYSTEMS[system] for option in ("--platform", tag)]
    command = [
        sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--dry-run", "--ignore-installed",
        "--no-deps", "--only-binary=:all:", "--implementation", "cp", "--python-version", python,
        "--target", "unused", *tags, pin,
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=_LIMIT_S, check=False)
    return done.returncode == 0


if __name__ == "__main__":
    sys.exit(main())

"""Mutation testing: which small changes of the code does no test detect?

Run: python bench/mutation.py [--count 30] [--seed 1] [--only association] [--write docs/mutation.md]

A mutant is one changed operator, number or condition. cosmic-ray makes them, tests each in a copy of the repository and keeps the
results; `--count` mutants of every package are drawn at random and tested by the quick tests of that package; the first failing
test kills a mutant. What survives is either a missing test or a change without effect: read them.

Each package has a session in `--work` until its code or its tests change: a run that was stopped continues, and
`cr-report SESSION --show-diff` lists it. Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cosmic_ray.ast import get_ast_from_path
from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, WorkItem
from harness import ROOT, Row, answer, arguments, note

# what decides whether and how fast a robot moves
_GUARDS = ("gate", "limits", "follower", "separation", "mapping", "kinematics", "joints")
_RECORDED = ("following", "opening", "result_folder", "second_pass", "solve", "time_steps", "track")
# name: files, and the tests that are about them
PACKAGES = {
    "association": (("src/posefuse/association/**/*.py",), ("tests/association", "tests/laws/test_associate_laws.py")),
    "body": (("src/posefuse/kinematics/**/*.py",), ("tests/kinematics", "tests/derivatives", "tests/truth/test_angles.py")),
    "fusion": (
        ("src/posefuse/fusion/**/*.py",),
        (
            "tests/fusion",
            "tests/laws/test_fuse_laws.py",
            "tests/derivatives",
            "tests/oracles/test_fuse_against_opencv.py",
        ),
    ),
    "recorded pipeline": (
        tuple(f"src/posefuse/pipeline/{name}.py" for name in _RECORDED),
        (
            "tests/pipeline",
            "tests/ros/test_live_recording.py",
            "tests/cli/test_interruptions.py",
            "tests/truth/test_recorded_pipeline.py",
        ),
    ),
    "teleoperation": (
        tuple(f"packages/posefuse-teleop/src/posefuse_teleop/{name}.py" for name in _GUARDS),
        tuple(f"tests/teleoperation/test_{name}.py" for name in ("faults", "mujoco_robot", *_GUARDS[:5])),
    ),
    "tracking": (("src/posefuse/tracking/**/*.py",), ("tests/tracking", "tests/laws/test_smooth_laws.py")),
}
_PYTEST = (sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not realtime and not fuzz")
_NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "out", "dist", "build", "shared", "__pycache__", ".*_cache")
# `int | None` is an annotation nearly everywhere; decorators carry caching and `property`
_LEFT_OUT = re.compile(".*BinaryOperator_BitOr|.*RemoveDecorator")
_ANNOTATIONS = ("annassign", "tfpdef", "decorator", "import_from", "import_name")
# a mutant that takes this many times as long as the tests alone hangs; so much more for compiling kernels again
_LONGER, _COMPILING_S = 4.0, 120.0


@contextlib.contextmanager
def copied(folder: Path) -> Iterator[None]:
    """Work in a copy of the repository, whose packages are imported by tests."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT, folder, ignore=_NOT_COPIED)
    os.environ["PYTHONPATH"] = os.pathsep.join(map(str, [folder / "src", *folder.glob("packages/*/src")]))
    with contextlib.chdir(folder):
        imported = subprocess.check_output([sys.executable, "-c", "import posefuse; print(posefuse.__file__)"], text=True)
        if not Path(imported.strip()).is_relative_to(folder):
            raise SystemExit(f"expected tests of {folder}, they would be of {imported.strip()}")
        yield


def files_of(package: str) -> tuple[list[Path], list[Path]]:
    """Files that are changed, and files of tests."""
    patterns, tests = PACKAGES[package]
    found = [sorted(Path(test).rglob("test_*.py")) or [Path(test)] for test in tests]
    return sorted(path for pattern in patterns for path in Path().glob(pattern)), [path for one in found for path in one]


def session_of(package: str, work: Path, count: int, seed: int) -> Path:
    """Where the results for this code and these tests are kept."""
    text = b"".join(path.read_bytes() for paths in files_of(package) for path in paths)
    return work / f"{package.replace(' ', '_')}-{count}-{seed}-{hashlib.sha256(text).hexdigest()[:12]}.sqlite"


def mutation_of(item: WorkItem) -> MutationSpec:
    return item.mutations[0]


def in_order(item: WorkItem) -> tuple[str, int, str, int]:
    one = mutation_of(item)
    return str(one.module_path), one.start_pos[0], one.operator_name, one.occurrence


def draw(session: WorkDB, paths: list[Path], count: int, seed: int) -> None:
    """Fill a session with a random sample of the mutants of some files, the same for the same code and seed."""
    init(paths, session, {})
    trees = {path: get_ast_from_path(path) for path in paths}

    def counts(one: MutationSpec) -> bool:
        node = trees[one.module_path].get_leaf_for_position(one.start_pos)
        while node is not None and node.type not in _ANNOTATIONS:
            node = node.parent
        return node is None and not _LEFT_OUT.match(one.operator_name)

    every = sorted((item for item in session.work_items if counts(mutation_of(item))), key=in_order)
    session.clear()
    session.add_work_items(sorted(random.Random(seed).sample(every, min(count, len(every))), key=in_order))


def test_mutants(session: WorkDB, tests: list[Path]) -> None:
    """Test every mutant that has no result so far; ends the program where the tests fail without any."""
    pending = session.pending_work_items
    if not pending:
        return
    began = time.monotonic()
    if subprocess.run([*_PYTEST, *map(str, tests)], capture_output=True).returncode:
        raise SystemExit(f"{' '.join(map(str, tests))}: they fail without any mutant")
    limit_s = _LONGER * (time.monotonic() - began) + _COMPILING_S
    for item in pending:
        module = mutation_of(item).module_path.stem
        # tests that name the changed module come first: most mutants are killed sooner so
        nearest = sorted(tests, key=lambda path: module not in path.read_text("utf-8"))
        result = mutate_and_test(item.mutations, shlex.join([*_PYTEST, *map(str, nearest)]), limit_s)
        session.set_result(item.job_id, result)
        note(f"  {result.output if result.output == 'timeout' else result.test_outcome.value:9}{place_of(item)} {change(result)}")


def place_of(item: WorkItem) -> str:
    """File and line, for people."""
    return f"{re.sub('.*src/(posefuse/)?', '', str(mutation_of(item).module_path))}:{mutation_of(item).start_pos[0]}"


def change(result: Any) -> str:
    """The changed line, before and after, fit for a cell of a Markdown table."""
    before, after = (re.search(rf"^[{sign}](?![{sign}])(.*)", result.diff, re.MULTILINE) for sign in "-+")
    return " -> ".join(one[1].strip() for one in (before, after) if one).replace("|", "\\|")


def results_of(package: str, session: WorkDB) -> tuple[Row, list[Row]]:
    """Counts, and the survivors."""
    done = sorted(session.completed_work_items, key=lambda pair: in_order(pair[0]))
    alive = [
        {"package": package, "place": f"`{place_of(item)}`", "change": f"`{change(result)}`"}
        for item, result in done
        if not result.is_killed
    ]
    killed = len(done) - len(alive)
    counts = {"package": package, "mutants drawn": session.num_work_items, "tested": len(done), "killed": killed}
    return {**counts, "score": f"{killed / len(done):.0%}" if done else ""}, alive


def main() -> None:
    args = arguments(__doc__, count=30, seed=1, only=PACKAGES, work=Path("out/mutation"))
    work, rows, survivors = args.work.resolve(), [], []
    work.mkdir(parents=True, exist_ok=True)
    with copied(work / "copy"):
        for package in PACKAGES:
            paths, tests = files_of(package)
            with use_db(session_of(package, work, args.count, args.seed), WorkDB.Mode.create) as session:
                if not session.num_work_items:
                    draw(session, paths, args.count, args.seed)
                if package in args.only:
                    test_mutants(session, tests)
                row, alive = results_of(package, session)
            rows.append(row)
            survivors += alive
    answer(args, {"Mutants": rows} | ({"Survivors": survivors} if survivors else {}))


if __name__ == "__main__":
    main()

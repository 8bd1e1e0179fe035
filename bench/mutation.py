"""Mutation testing: which small changes of the code would no test notice?

Run: python bench/mutation.py [--count 30] [--seed 1] [--only association] [--page docs/mutation.md]

A mutant is one changed operator, number or condition (cosmic-ray makes them). `--count` mutants of every package are drawn at
random and tested in a copy of the repository by the quick tests of that package; the first failing test kills a mutant, and so
does a run of more than `--limit-s`. What survives is either a missing test or a change without effect (marked neither way
here; read them). JSON goes to stdout, the table to stderr and, on request, to a page.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosmic_ray import plugins
from cosmic_ray.ast import get_ast
from cosmic_ray.mutating import mutate_code

REPOSITORY = Path(__file__).resolve().parents[1]
_RECORDED = ("following", "images", "result_folder", "run", "second_pass", "session", "solve", "store", "time_steps", "writing")
# name: files below src/posefuse, and the tests that are about them
PACKAGES = {
    "association": (("association/**/*.py",), ("tests/association", "tests/laws/test_associate_laws.py")),
    "recorded pipeline": (
        tuple(f"pipeline/{name}.py" for name in _RECORDED),
        ("tests/pipeline", "tests/truth/test_recorded_pipeline.py", "tests/cli/test_interruptions.py"),
    ),
    "tracking": (("tracking/**/*.py",), ("tests/tracking", "tests/laws/test_smooth_laws.py")),
}
_COPIED = ("src", "tests", "examples", "bench", "paper", "docs", "pyproject.toml", "README.md")
# `int | None` is an annotation nearly everywhere; decorators carry caching and `property`; variables need a list of names
_LEFT_OUT = ("ReplaceBinaryOperator_BitOr", "RemoveDecorator", "Variable")
_ANNOTATIONS = ("annassign", "tfpdef", "decorator", "import_from", "import_name")


@dataclass(frozen=True, order=True)
class Mutant:
    """One change: occurrence `index` of `operator` in `path` (relative to the repository), at `line`."""

    path: str
    line: int
    operator: str
    index: int


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Every mutant of one file."""
    nodes = list(_nodes(get_ast(path.read_text(encoding="utf-8")), annotation=False))
    for name in plugins.operator_names():
        if any(part in name for part in _LEFT_OUT):
            continue
        operator = plugins.get_operator(name)()
        index = 0
        for node, annotation in nodes:
            for (line, _), _ in operator.mutation_positions(node):
                if not annotation:
                    yield Mutant(str(path.relative_to(REPOSITORY)), line, name, index)
                index += 1


def _nodes(node: Any, annotation: bool) -> Iterator[tuple[Any, bool]]:
    """Every node of a syntax tree in the order in which mutations are counted, and whether it is part of an annotation."""
    annotation = annotation or node.type in _ANNOTATIONS
    yield node, annotation
    for child in getattr(node, "children", ()):
        yield from _nodes(child, annotation)


def draw(patterns: tuple[str, ...], count: int, seed: int) -> list[Mutant]:
    """A random sample of the mutants of some files, the same for the same code and seed."""
    files = sorted(path for pattern in patterns for path in (REPOSITORY / "src" / "posefuse").glob(pattern))
    every = sorted({mutant for path in files for mutant in mutants_of(path)})
    return sorted(random.Random(seed).sample(every, min(count, len(every))))


def copy_repository(folder: Path) -> None:
    """What the tests need."""
    for name in _COPIED:
        source = REPOSITORY / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy2(source, folder / name)


def tests_fail(folder: Path, tests: tuple[str, ...], limit_s: float) -> bool:
    """Whether any test fails, or they do not end in time."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", "not slow and not realtime", *tests]
    environment = os.environ | {"PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, timeout=limit_s).returncode != 0
    except subprocess.TimeoutExpired:
        return True


def survivors_of(folder: Path, mutants: list[Mutant], tests: tuple[str, ...], limit_s: float) -> list[Mutant]:
    """The mutants that no test notices."""
    survivors = []
    for mutant in mutants:
        file = folder / mutant.path
        original = file.read_text(encoding="utf-8")
        changed = mutate_code(original, plugins.get_operator(mutant.operator)(), mutant.index)
        if changed is None:
            raise RuntimeError(f"{mutant}: no such place")
        file.write_text(changed, encoding="utf-8")
        try:
            killed = tests_fail(folder, tests, limit_s)
        finally:
            file.write_text(original, encoding="utf-8")
        print(
            f"  {'killed  ' if killed else 'SURVIVED'} {mutant.path}:{mutant.line} {mutant.operator}", file=sys.stderr, flush=True
        )
        survivors += [] if killed else [mutant]
    return survivors


def page(results: dict[str, dict[str, Any]], seed: int) -> str:
    """The page of the docs."""
    lines = [
        "# Mutation testing",
        "",
        "How many small changes of the code do the quick tests of a package notice? Made by `make mutation` "
        f"(`bench/mutation.py`, seed {seed}); a random sample of each package's mutants. A survivor is a missing test or a "
        "change without effect.",
        "",
        "| package | mutants | killed | score |",
        "|---|---|---|---|",
    ]
    for name, result in results.items():
        lines.append(f"| {name} | {result['mutants']} | {result['killed']} | {result['score']:.0%} |")
    lines += ["", "Survivors:", ""]
    for result in results.values():
        lines += [f"- `{one['path']}:{one['line']}` {one['operator'].removeprefix('core/')}" for one in result["survivors"]]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--limit-s", type=float, default=600.0)
    parser.add_argument("--only", nargs="*", choices=sorted(PACKAGES), default=sorted(PACKAGES))
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()

    results: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copy_repository(folder)
        drawn = {package: draw(PACKAGES[package][0], arguments.count, arguments.seed) for package in arguments.only}
        for package in arguments.only:
            mutants, tests = drawn[package], PACKAGES[package][1]
            if tests_fail(folder, tests, arguments.limit_s):
                raise SystemExit(f"{package}: the tests fail without any mutant")
            survivors = survivors_of(folder, mutants, tests, arguments.limit_s)
            killed = len(mutants) - len(survivors)
            results[package] = {
                "mutants": len(mutants),
                "killed": killed,
                "score": killed / len(mutants),
                "survivors": [vars(one) for one in survivors],
            }
            print(f"{package}: {killed} of {len(mutants)} killed", file=sys.stderr, flush=True)
    print(json.dumps(results, indent=2))
    if arguments.page:
        arguments.page.write_text(page(results, arguments.seed), encoding="utf-8")


if __name__ == "__main__":
    main()

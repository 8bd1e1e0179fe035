"""Mutants of a file: which there are, a random sample of them, and whether the tests of a copy of the repository notice one."""

from __future__ import annotations

import hashlib
import os
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cosmic_ray import plugins
from cosmic_ray.ast import get_ast
from cosmic_ray.mutating import mutate_code

REPOSITORY = Path(__file__).resolve().parents[1]
_COPIED = (
    "src",
    "packages",
    "tests",
    "examples",
    "bench",
    "paper",
    "docs",
    "tools",
    "mkdocs.yml",
    "pyproject.toml",
    "README.md",
    "CONTRIBUTING.md",
)
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

    def key(self, tests: str) -> str:
        """Names the mutant together with all that its answer depends on: the file's text, and a digest of the tests."""
        text = (REPOSITORY / self.path).read_bytes()
        about = f"{self.path} {self.operator} {self.index} {hashlib.sha256(text).hexdigest()} {tests}"
        return hashlib.sha256(about.encode()).hexdigest()[:16]

    @property
    def place(self) -> str:
        """File and line, for people."""
        return f"{re.sub('.*src/(posefuse/)?', '', self.path)}:{self.line}"

    def texts(self) -> tuple[str, str]:
        """The file without and with the change."""
        original = (REPOSITORY / self.path).read_text(encoding="utf-8")
        changed = mutate_code(original, plugins.get_operator(self.operator)(), self.index)
        if changed is None:
            raise RuntimeError(f"{self}: no such place")
        return original, changed

    def diff(self) -> str:
        """The changed line, before and after, fit for a cell of a Markdown table."""
        pairs = zip(*(text.splitlines() for text in self.texts()), strict=False)
        return next((f"{before.strip()} -> {after.strip()}" for before, after in pairs if before != after), "").replace(
            "|", "\\|"
        )


def draw(patterns: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """A random sample of the mutants of some files, the same for the same code and seed."""
    files = sorted(path for pattern in patterns for path in REPOSITORY.glob(pattern))
    every = sorted({mutant for path in files for mutant in _mutants_of(path)})
    return sorted(random.Random(seed).sample(every, min(count, len(every))))


def _mutants_of(path: Path) -> Iterator[Mutant]:
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


class Copy:
    """A copy of the repository in which one file at a time is changed; it is kept, so that kernels stay compiled."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder = folder.resolve()
        # a test that was deleted must not continue killing
        shutil.rmtree(folder / "tests", ignore_errors=True)
        for name in _COPIED:
            source, target = REPOSITORY / name, folder / name
            if source.is_dir():
                shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
            else:
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, target)

    def baseline_s(self, tests: Sequence[str]) -> float:
        """Seconds that the tests take without any mutant; ends the program when they fail, or would test another posefuse."""
        script = "import posefuse; print(posefuse.__file__)"
        found = subprocess.run(
            [sys.executable, "-c", script], cwd=self.folder, env=self._environment(), capture_output=True, text=True
        )
        if not Path(found.stdout.strip()).is_relative_to(self.folder):
            raise SystemExit(f"expected tests of {self.folder}, they would be of {found.stdout.strip()}")
        began = time.monotonic()
        if self._run(list(tests), None, write_bytecode=True) != "passed":
            raise SystemExit(f"{' '.join(tests)}: they fail without any mutant")
        return time.monotonic() - began

    def answer(self, mutant: Mutant, tests: Sequence[str], limit_s: float) -> str:
        """The result of the tests for a mutant: ``killed``, ``survived``, or ``timeout``."""
        file = self.folder / mutant.path
        stat = file.stat()
        original, changed = mutant.texts()
        file.write_text(changed, encoding="utf-8")
        try:
            return {"passed": "survived", "failed": "killed", "timeout": "timeout"}[
                self._run(self._nearest_first(mutant, tests), limit_s)
            ]
        finally:
            file.write_text(original, encoding="utf-8")
            # compiled code is kept by the file's date
            os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    def _nearest_first(self, mutant: Mutant, tests: Sequence[str]) -> list[str]:
        """Test files that name the changed module come first: most mutants are killed sooner so."""
        files = [path for test in tests for path in sorted((self.folder / test).rglob("test_*.py")) or [self.folder / test]]
        module = Path(mutant.path).stem
        return [
            str(path.relative_to(self.folder)) for path in sorted(files, key=lambda path: module not in path.read_text("utf-8"))
        ]

    def _run(self, tests: list[str], limit_s: float | None, write_bytecode: bool = False) -> str:
        marks = "not slow and not realtime and not fuzz"
        command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-m", marks, *tests]
        environment = self._environment()
        if not write_bytecode:
            environment["PYTHONDONTWRITEBYTECODE"] = "1"
        try:
            done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, timeout=limit_s)
        except subprocess.TimeoutExpired:
            return "timeout"
        return "failed" if done.returncode else "passed"

    def _environment(self) -> dict[str, str]:
        return os.environ | {"PYTHONPATH": os.pathsep.join(map(str, [self.folder / "src", *self.folder.glob("packages/*/src")]))}

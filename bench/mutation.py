"""Mutation testing: which small changes of the code does no test detect?

Run: python bench/mutation.py [--count 30] [--seed 1] [--only association] [--page docs/mutation.md]

A mutant is one changed operator, number or condition (cosmic-ray makes them). `--count` mutants of every package are drawn at
random and tested in a copy of the repository by the quick tests of that package; the first failing test kills a mutant. What
survives is either a missing test or a change without effect: read them.

Answers are kept in `--work` until the code changes, those of survivors until the tests change: a run that was stopped continues.
JSON goes to stdout.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

from harness import arguments, note
from mutants import REPOSITORY, Copy, Mutant, draw

# what decides whether and how fast a robot moves
_GUARDS = ("gate", "limits", "follower", "separation", "mapping", "kinematics", "joints")
_RECORDED = ("following", "opening", "result_folder", "second_pass", "solve", "time_steps", "track")
# name: files, and the tests that are about them
PACKAGES = {
    "association": (("src/posefuse/association/**/*.py",), ("tests/association", "tests/laws/test_associate_laws.py")),
    "body": (("src/posefuse/kinematics/**/*.py",), ("tests/kinematics", "tests/derivatives", "tests/truth/test_angles.py")),
    "fusion": (
        ("src/posefuse/fusion/**/*.py",),
        ("tests/fusion", "tests/laws/test_fuse_laws.py", "tests/laws/test_depth_laws.py", "tests/derivatives"),
    ),
    "recorded pipeline": (
        tuple(f"src/posefuse/pipeline/{name}.py" for name in _RECORDED),
        (
            "tests/pipeline",
            "tests/ros/test_live_recording.py",
            "tests/pipeline/test_whole_body.py",
            "tests/cli/test_interruptions.py",
            "tests/cli/test_limits.py",
            "tests/truth/test_recorded_pipeline.py",
        ),
    ),
    "teleoperation": (
        tuple(f"packages/posefuse-teleop/src/posefuse_teleop/{name}.py" for name in _GUARDS),
        (
            "tests/teleoperation/test_faults.py",
            "tests/teleoperation/test_follower.py",
            "tests/teleoperation/test_gate.py",
            "tests/teleoperation/test_limits.py",
            "tests/teleoperation/test_mapping.py",
            "tests/teleoperation/test_mujoco_robot.py",
            "tests/teleoperation/test_separation.py",
        ),
    ),
    "tracking": (("src/posefuse/tracking/**/*.py",), ("tests/tracking", "tests/laws/test_smooth_laws.py")),
}
# a mutant that takes this many times as long as the tests alone hangs; so much more for compiling kernels again
_LONGER, _COMPILING_S = 4.0, 120.0


def digest_of(tests: tuple[str, ...]) -> str:
    """Changes with the tests."""
    files = sorted(path for test in tests for path in (sorted((REPOSITORY / test).rglob("*.py")) or [REPOSITORY / test]))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()[:16]


class Answers:
    """What is known about mutants, kept in a file after each one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, dict[str, Any]] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}

    def of(self, mutant: Mutant, tests: str) -> str | None:
        """The answer; one of older tests counts if they killed the mutant."""
        found = self._known.get(mutant.key(""))
        return str(found["answer"]) if found and (found["tests"] == tests or found["answer"] != "survived") else None

    def keep(self, mutant: Mutant, tests: str, answer: str) -> None:
        """Keep an answer."""
        self._known[mutant.key("")] = {"answer": answer, "tests": tests, **vars(mutant)}
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(self._known, indent=1), encoding="utf-8")
        part.replace(self._path)


def test_mutants(package: str, mutants: list[Mutant], answers: Answers, work: Path) -> None:
    """Test every mutant that has no answer so far."""
    tests = PACKAGES[package][1]
    digest = digest_of(tests)
    left = [mutant for mutant in mutants if answers.of(mutant, digest) is None]
    if not left:
        return
    copy = Copy(work / "copy")
    limit_s = _LONGER * copy.baseline_s(tests) + _COMPILING_S
    for mutant in left:
        answer = copy.answer(mutant, tests, limit_s)
        answers.keep(mutant, digest, answer)
        note(f"  {answer:9}{mutant.path}:{mutant.line} {mutant.diff()}")


def results_of(mutants: list[Mutant], answers: Answers, digest: str) -> dict[str, Any]:
    """Counts and survivors of a package."""
    known = {mutant: answers.of(mutant, digest) for mutant in mutants}
    count = Counter(known.values())
    tested = len(mutants) - count[None]
    return {
        "drawn": len(mutants),
        "tested": tested,
        "killed": count["killed"] + count["timeout"],
        "score": (count["killed"] + count["timeout"]) / tested if tested else 0.0,
        "survivors": [{"place": one.place, "change": one.diff()} for one in mutants if known[one] == "survived"],
    }


def page(results: dict[str, dict[str, Any]], seed: int) -> str:
    """The page of the docs."""
    lines = [
        "# Mutation testing",
        "",
        "How many small changes of the code do the quick tests of a package detect? A mutant is one changed operator, number or "
        "condition; a random sample of each package's mutants is tested, one at a time, and the first failing test kills a "
        f"mutant. Made by `make mutation` (`bench/mutation.py`, seed {seed}).",
        "",
        "| package | mutants drawn | tested | killed | score |",
        "|---|---|---|---|---|",
        *(f"| {name} | {one['drawn']} | {one['tested']} | {one['killed']} | {_score(one)} |" for name, one in results.items()),
        "",
        "A survivor is a missing test, or a change without effect (for example a tolerance that is a little larger).",
        "",
    ]
    for name, one in results.items():
        if one["survivors"]:
            rows = [f"| `{each['place']}` | `{each['change']}` |" for each in one["survivors"]]
            lines += [f"## Survivors in {name}", "", "| place | change |", "|---|---|", *rows, ""]
    return "\n".join(lines)


def _score(result: dict[str, Any]) -> str:
    return f"{result['score']:.0%}" if result["tested"] else ""


def main() -> None:
    args = arguments(__doc__, count=30, seed=1, only=PACKAGES, work=Path("out/mutation"), page=Path)
    args.work.mkdir(parents=True, exist_ok=True)
    answers = Answers(args.work / "answers.json")
    results: dict[str, dict[str, Any]] = {}
    for package in PACKAGES:
        mutants = draw(PACKAGES[package][0], args.count, args.seed)
        if package in args.only:
            test_mutants(package, mutants, answers, args.work)
        results[package] = results_of(mutants, answers, digest_of(PACKAGES[package][1]))
        one = results[package]
        note(f"{package}: {one['killed']} of {one['tested']} killed, {one['drawn']} drawn")
    print(json.dumps(results, indent=2))
    if args.page:
        args.page.write_text(page(results, args.seed), encoding="utf-8")


if __name__ == "__main__":
    main()

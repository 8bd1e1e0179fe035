"""Attempts to make posefuse lose work or fail, as one table per kind: what must hold, number of variants, result.

python tests/fuzz/attempts.py deletions interruptions --write docs/reliability.md
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import pytest
from drive import ROOT

KINDS: dict[str, tuple[str, ...]] = {
    "deletions": ("tests/cli/test_nothing_is_lost.py", "tests/foundation/test_output_folder.py"),
    "interruptions": ("tests/cli/test_interruptions.py",),
    "interrupts": ("tests/cli/test_interrupts.py",),
    "live": ("tests/realtime/test_session_outputs.py", "tests/realtime/test_outputs.py"),
    "stress": ("tests/realtime/test_stress.py",),
    "damaged": ("tests/cli/test_damaged_videos.py", "tests/sources/test_coverage.py", "tests/cli/test_limits.py"),
    "systems": ("tests/edges/test_other_systems.py",),
}


class Attempts:
    """Collects the result of each test (passed, skipped with its reason, or failed) and what it measured."""

    def __init__(self) -> None:
        self.rows: dict[str, list[str]] = {}
        self.outcomes: dict[str, list[str]] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Called by pytest after the set-up, the call and the end of every test."""
        title = _title(report.nodeid)
        if report.when == "call" or report.skipped:
            self.outcomes.setdefault(title, []).append(_outcome(report))
            self.rows.setdefault(title, []).extend(f"{value} {name}" for name, value in report.user_properties)
        elif report.failed:
            self.outcomes.setdefault(title, []).append(f"failed ({report.when})")

    def table(self) -> str:
        """One row for each test, in order; tests that differ only in a parameter share a row with their count."""
        lines = ["| what must hold | tried | result |", "|---|---:|---|"]
        for title, outcomes in self.outcomes.items():
            others = sorted({one for one in outcomes if one != "held"})
            result = "; ".join([*(others or ["held"]), *self.rows.get(title, [])])
            lines.append(f"| {title} | {len(outcomes)} | {result} |")
        return "\n".join(lines)


def _title(nodeid: str) -> str:
    """The test's name as a sentence: `a/b.py::test_x_y[z]` becomes `x y`."""
    return nodeid.rpartition("::")[2].partition("[")[0].removeprefix("test_").replace("_", " ").strip()


def _outcome(report: pytest.TestReport) -> str:
    if report.skipped:
        return f"not tried ({report.longrepr[2]})" if isinstance(report.longrepr, tuple) else "not tried"
    return "held" if report.passed else "FAILED"


def main() -> int:
    """0 when everything held."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"one of: {', '.join(KINDS)}; default all")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the tables between the marks of this page")
    args = parser.parse_args()
    worst = 0
    for kind in args.kinds or KINDS:
        attempts = Attempts()
        code = pytest.main([f"--rootdir={ROOT}", "-q", "-m", "", *(str(ROOT / path) for path in KINDS[kind])], plugins=[attempts])
        worst = max(worst, int(code))
        print(attempts.table())
        if args.write:
            from page_marks import write_between_marks

            write_between_marks(args.write, attempts.table(), kind)
    return worst


if __name__ == "__main__":
    sys.exit(main())

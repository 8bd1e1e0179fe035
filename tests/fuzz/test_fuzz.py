"""Damaged files: a few of every kind here, thousands by `make fuzz`."""

import json
import re
from pathlib import Path

import pytest
from running import printed, python

HERE = Path(__file__).parent
DRIVE = str(HERE / "drive.py")
# of a whole run; a single variant has 20 s
LIMIT_S = 600
FULL_LIMIT_S = 7200


def test_a_few_damaged_files_of_every_reader() -> None:
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    done = python(DRIVE, "--variants", "17", "--readers-only", limit_s=LIMIT_S)
    assert done.returncode == 0, done.stdout[:5000] + done.stderr[-5000:]


@pytest.mark.fuzz
def test_thousands_of_damaged_files() -> None:
    done = python(DRIVE, limit_s=FULL_LIMIT_S)
    assert done.returncode == 0, done.stdout[:20_000] + done.stderr[-5000:]


@pytest.mark.slow
def test_the_stage_can_fail() -> None:
    """A reader that raises, hangs, crashes or warns is found out, and the next variant is still read."""
    code = """
import sys, json
sys.path.insert(0, sys.argv[1])
import drive
from pathlib import Path
worker = drive.Worker()
asked = [("self-test " + what, worker.ask("self-test " + what, Path("."), "x", 2.0 if what == "hang" else 300.0)[0])
         for what in ("trace", "warning", "hang", "crash", "clear", "accepted")]
worker.stop()
print(json.dumps(asked))
"""
    outcomes = dict(json.loads(printed("-c", code, str(HERE), limit_s=LIMIT_S).splitlines()[-1]))
    assert tuple(outcomes.values()) == ("trace", "trace", "hang", "crash", "clear", "accepted")


def test_every_test_that_the_page_names_is_there() -> None:
    named = re.findall(r"`(?:tests/)?(?:\w+/)*(test_\w+\.py)`", (HERE.parents[1] / "docs" / "reliability.md").read_text())
    assert len(named) > 10 and {*named} <= {path.name for path in HERE.parent.rglob("test_*.py")}

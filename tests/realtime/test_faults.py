"""One session on two machines (network namespaces) whose link and clocks fail; the benchmark runs it and measures."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

BENCH = Path(__file__).resolve().parents[2] / "bench"


@pytest.mark.slow
def test_a_cut_link_and_a_clock_that_is_off_are_survived_and_found() -> None:
    from bench import two_machines

    if reason := two_machines.why_not():
        pytest.skip(reason)
    command = [sys.executable, str(BENCH / "live_faults.py"), "--detector", "oracle", "--only", "link: cut", "link: clock"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    cut, clock = json.loads(done.stdout)["cases"]
    assert cut["named"] == "silent"
    assert cut["named_s"] is not None and cut["back_s"] is not None
    assert cut["blamed_wrongly"] == []
    assert cut["unused_s"] > 9
    assert cut["shown_share"] > 0.99
    assert clock["clock_ms"] == pytest.approx(50, abs=5)

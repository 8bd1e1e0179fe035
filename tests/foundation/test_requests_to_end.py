"""Requests to end a program: those that `nohup` ignores, a terminal that was closed, children that their parent ends."""

import os
import signal
import subprocess
import sys

import pytest
from running import python

from posefuse.foundation import requests_to_end
from posefuse.foundation.requests_to_end import HANG_UP, REQUESTS_TO_END, heeded

PATIENCE_S = 60.0

if HANG_UP is None:
    pytest.skip("this system has no SIGHUP", allow_module_level=True)


def test_hang_ups_that_are_ignored_stay_ignored() -> None:
    assert heeded(REQUESTS_TO_END) == [signal.SIGTERM, signal.SIGHUP]
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert heeded(REQUESTS_TO_END) == [signal.SIGTERM]
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("released", [True, False])
def test_printing_to_a_closed_terminal_is_no_error_once_it_is_released(released: bool) -> None:
    script = f"""
import signal, sys
from posefuse.foundation.requests_to_end import without_terminal
signal.signal(signal.SIGHUP, signal.SIG_IGN)
print('ready', flush=True)
sys.stdin.read()
{"without_terminal()" if released else ""}
print('more', flush=True)
"""
    ours, theirs = os.openpty()
    streams = {"stdin": subprocess.PIPE, "stdout": theirs, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([sys.executable, "-c", script], **streams, start_new_session=True)
    os.close(theirs)
    seen = b""
    while not seen.endswith(b"\n"):
        seen += os.read(ours, 1)
    os.close(ours)
    process.stdin.close()
    assert (process.wait(PATIENCE_S) == 0) is released


def test_a_child_outlives_a_request_for_its_parent_but_not_for_ever() -> None:
    script = """
import signal, time
from posefuse.foundation import requests_to_end
requests_to_end._GRACE_S = 0.5
requests_to_end.leave_requests_to_parent()
for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
    signal.raise_signal(number)
print('alive', flush=True)
time.sleep(600)
"""
    done = python("-c", script)
    assert (done.returncode, done.stdout) == (143, "alive\n"), done.stderr
    assert requests_to_end._GRACE_S > 10

"""Imported as `sitecustomize` by every process of a test: its clock is set by CLOCK_SET_S seconds once CLOCK_SET_BY is there."""

import os
import time

_file, _by_s = os.environ["CLOCK_SET_BY"], float(os.environ["CLOCK_SET_S"])
_time, _time_ns = time.time, time.time_ns


def _off_s() -> float:
    return _by_s if os.path.exists(_file) else 0.0  # noqa: PTH110 - imported before anything else


time.time = lambda: _time() + _off_s()
time.time_ns = lambda: _time_ns() + round(_off_s() * 1e9)

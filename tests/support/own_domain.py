"""DDS domains that no other process of this machine's test runs uses at the same time."""

import os

# three domains for each of four workers, for each of 18 runs: the highest that has ports is 232
_WORKERS, _RUNS, _EACH = 4, 18, 3


def own_domain() -> int:
    """The first of this process's three domains."""
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    run = os.getppid() if worker else os.getpid()
    return 10 + _EACH * (_WORKERS * (run % _RUNS) + int(worker.removeprefix("gw") if worker else 0) % _WORKERS)

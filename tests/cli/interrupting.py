"""Runs `posefuse` in this process and sends signals to it when named functions are called: python interrupting.py POINTS ARGS...

POINTS is JSON: a list of [module, function, call number, signal]; signal "full" raises "no space left", "bug" a ValueError.
"""

import errno
import importlib
import json
import os
import signal
import sys
from typing import Any

from posefuse.cli.main import main


def interrupt(module: str, path: str, call: int, what: str) -> None:
    owner: Any = importlib.import_module(module)
    *outer, name = path.split(".")
    for part in outer:
        owner = getattr(owner, part)
    original, calls = getattr(owner, name), 0

    def called(*args: object, **kwargs: object) -> object:
        nonlocal calls
        calls += 1
        if calls == call and what == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        if calls == call and what == "bug":
            raise ValueError("not thought of")
        if calls == call:
            os.kill(os.getpid(), getattr(signal, what))
        return original(*args, **kwargs)

    setattr(owner, name, called)


if __name__ == "__main__":
    # a shell that runs the tests in the background has them ignore Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for point in json.loads(sys.argv[1]):
        interrupt(*point)
    sys.exit(main(sys.argv[2:]))

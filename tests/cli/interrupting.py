"""Runs `posefuse` many times, each in a process of its own, and sends signals to it when named functions are called.

`python interrupting.py ARGS...` runs `posefuse ARGS...` itself and prints its exit status; then modules are imported and kernels
loaded. Each line of its input is JSON, [POINTS, ARGS, OUT, ERR, LIMIT_S]: a fork runs `posefuse ARGS` with the files OUT and ERR
as its output, SIGALRM ends it after LIMIT_S, and its exit status is printed, negative for a signal.

POINTS: a list of [module, function, call number, signal]; signal "full" raises "no space left", "bug" a ValueError.
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


def redirect(out: str, err: str) -> None:
    for place, path in enumerate((os.devnull, out, err)):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), place)


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    print(main(sys.argv[1:]), file=answers)
    for line in sys.stdin:
        points, arguments, out, err, limit_s = json.loads(line)
        sys.stdout.flush()
        if pid := os.fork():
            print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), file=answers)
            continue
        redirect(out, err)
        signal.alarm(limit_s)
        # a shell that runs the tests in the background has them ignore Ctrl-C
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for point in points:
            interrupt(*point)
        sys.exit(main(arguments))

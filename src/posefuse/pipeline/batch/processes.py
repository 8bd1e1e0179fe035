"""A process per trial: whatever becomes of it, killed for memory included, the others continue.

The process reads its task from its standard input and writes its outcome, one line of JSON, to its standard output. Its standard
input stays open while it is needed: it ends by itself when its parent process has ended.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import Any

from posefuse import __version__
from posefuse.core import DependencyError, InputError
from posefuse.foundation.platform import available_memory_bytes, usable_cores

from .tasks import Outcome, Task, run_task

# `bench/pipeline.py` measures a peak of 617 MB for four cameras of 640 x 480 px; larger images and hours of recording need more
MEMORY_PER_TRIAL_BYTES = 2_000_000_000
# detection alone keeps about two cores busy
CORES_PER_TRIAL = 2


def default_jobs() -> int:
    """How many trials fit into this machine at once: by its cores, and by the memory that is free now."""
    memory = available_memory_bytes()
    by_memory = 1 if memory is None else memory // MEMORY_PER_TRIAL_BYTES
    return max(1, min(usable_cores() // CORES_PER_TRIAL, by_memory))


class Processes:
    """Runs tasks in processes of their own, some at once; `close` ends those that still run."""

    def __init__(self) -> None:
        self._running: set[subprocess.Popen[str]] = set()
        self._lock = threading.Lock()
        self._closed = False

    def run(self, task: Task) -> Outcome:
        """Do a task in a process and wait for it; a process that dies is an outcome with a reason."""
        with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
            process = self._start(log.fileno())
            try:
                assert process.stdin is not None and process.stdout is not None
                process.stdin.write(task.to_json() + "\n")
                process.stdin.flush()
                answer = process.stdout.read()
                code = process.wait()
            except OSError:
                answer, code = "", process.wait()
            finally:
                self._end(process)
            log.seek(0)
            return _outcome(task, answer, code, log.read())

    def outcomes(self, tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
        """The outcomes of all tasks in the order they end, `jobs` at once."""
        with ThreadPoolExecutor(jobs) as pool:
            try:
                waiting: set[Future[Outcome]] = {pool.submit(self.run, task) for task in tasks}
                while waiting:
                    done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                    yield from (future.result() for future in done)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                self.close()
                raise

    def close(self) -> None:
        """End the processes that still run."""
        with self._lock:
            self._closed = True
            running = list(self._running)
        for process in running:
            process.kill()

    def _start(self, log: int) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "posefuse.pipeline.batch.processes"]
        with self._lock:
            if self._closed:
                raise KeyboardInterrupt
            # in a session of its own, so that Ctrl-C reaches the parent alone, which decides
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True, encoding="utf-8",
                start_new_session=sys.platform != "win32",
            )  # fmt: skip
            self._running.add(process)
        return process

    def _end(self, process: subprocess.Popen[str]) -> None:
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        with self._lock:
            self._running.discard(process)


def run_in_process(task_json: str) -> str:
    """`Processes.run` of plain texts, for workers of a cluster."""
    return Processes().run(Task.from_json(task_json)).to_json()


def _outcome(task: Task, answer: str, code: int, log: str) -> Outcome:
    try:
        return Outcome.from_json(answer)
    except (ValueError, TypeError, KeyError):
        pass
    if code < 0:
        killed = code == -getattr(signal, "SIGKILL", 9)
        reason = f"its process was ended by signal {-code}" + (" (out of memory?)" if killed else "")
    else:
        last = next((line.strip() for line in reversed(log.splitlines()) if line.strip()), "no message")
        reason = f"its process ended with status {code}: {last}"
    return Outcome(name=task.name, made_with=task.made_with, reason=reason)


def _end_with_parent() -> None:
    """End this process at once when its standard input is closed: the process that started it is gone."""
    sys.stdin.buffer.read()
    os._exit(1)


def main() -> None:
    """Entry point of the process."""
    task = Task.from_json(sys.stdin.readline())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    answer = sys.stdout
    sys.stdout = sys.stderr
    print(run_task(task).to_json(), file=answer, flush=True)
    # libraries with threads of their own may hang at the end
    os._exit(0)


if __name__ == "__main__":
    main()


# Trials on an existing Dask cluster (extra `cluster`): its workers see the same folders and have the same posefuse.

_CONNECT_S = 15.0
# tasks of a dead worker move to another one; a task that kills so many workers is the cause itself
_RETRIES = 2


def outcomes_on_cluster(tasks: Sequence[Task], address: str) -> Iterator[Outcome]:
    """The outcomes of all tasks in the order they end.

    A worker that is lost costs its unfinished trials their progress; other workers do them again.

    Raises:
        DependencyError: no ``distributed`` here. InputError: no scheduler or no worker at `address`, or another version there.
    """
    distributed = _distributed()
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"`scheduler={address}`: no Dask scheduler answers there ({error or 'timeout'})") from None
    with client:
        _check_workers(client, address)
        # the scheduler forgets a task as soon as no future of it is left
        futures = [
            client.submit(run_in_process, task.to_json(), key=f"posefuse-{task.name}-{task.made_with}", retries=_RETRIES)
            for task in tasks
        ]
        names = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                yield _outcome_of(names[future.key], future)
        finally:
            client.cancel(futures)


def _outcome_of(task: Task, future: Any) -> Outcome:
    if future.status == "finished":
        return Outcome.from_json(future.result())
    reason = f"the cluster gave it up: {future.exception()}" if future.status == "error" else f"the cluster {future.status} it"
    return Outcome(name=task.name, made_with=task.made_with, reason=" ".join(reason.split()))


def _check_workers(client: Any, address: str) -> None:
    try:
        versions = client.run(posefuse_version)
    except ImportError as error:
        raise InputError(f"`scheduler={address}`: a worker cannot import posefuse ({error}); install it there") from None
    if not versions:
        raise InputError(f"`scheduler={address}`: the cluster has no workers; start some with: dask worker {address}")
    others = sorted({version for version in versions.values() if version != __version__})
    if others:
        raise InputError(f"`scheduler={address}`: workers have posefuse {', '.join(others)}, here is {__version__}")


def posefuse_version() -> str:
    """Of this worker."""
    return __version__


def _distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise DependencyError("a scheduler needs Dask: pip install 'posefuse[cluster]'") from None
    return distributed

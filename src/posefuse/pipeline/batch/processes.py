"""A process per trial: whatever becomes of it, killed for memory included, the others continue."""

from __future__ import annotations

import importlib
import os
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from posefuse import __version__
from posefuse.core import DependencyError, InputError
from posefuse.foundation.channel import Channel, ChannelClosed, wait_any
from posefuse.foundation.parsing import one_line
from posefuse.foundation.platform import available_memory_bytes, usable_cores
from posefuse.foundation.worker import Worker

from .tasks import Outcome, Task, run_task

# `bench/pipeline.py` measures a peak of 617 MB for four cameras of 640 x 480 px; larger images and hours of recording need more
MEMORY_PER_TRIAL_BYTES = 2_000_000_000
# detection alone keeps about two cores busy
CORES_PER_TRIAL = 2
_LOOK_S, _END_S = 0.5, 5.0


def default_jobs() -> int:
    """How many trials fit into this machine at once: by its cores, and by the memory that is free now."""
    memory = available_memory_bytes()
    by_memory = 1 if memory is None else memory // MEMORY_PER_TRIAL_BYTES
    return max(1, min(usable_cores() // CORES_PER_TRIAL, by_memory))


def outcomes_here(tasks: Sequence[Task], jobs: int) -> Iterator[Outcome]:
    """The outcomes of all tasks in the order they end, `jobs` at once; a process that dies is an outcome with a reason.

    Processes that still run when no more outcomes are wanted are ended.
    """
    waiting, running = deque(tasks), dict[Worker, Task]()
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                worker = Worker(run_trial)
                running[worker] = waiting.popleft()
                worker.start(running[worker])
            wait_any([worker.channel for worker in running if worker.running], _LOOK_S)
            for worker, task in list(running.items()):
                outcome = worker.receive()
                if outcome is not None or not worker.running:
                    del running[worker]
                    worker.end(_END_S)
                    yield outcome or _died(task, worker.trouble)
    finally:
        for worker in running:
            worker.end(0.0)


def _died(task: Task, trouble: str) -> Outcome:
    return task.outcome(reason=trouble + (" (out of memory?)" if "SIGKILL" in trouble else ""))


def run_trial(channel: Channel, task: Task) -> None:
    """Body of the process; it ends at once when the one that started it is gone."""
    threading.Thread(target=_end_with_parent, args=(channel,), daemon=True).start()
    # what libraries print is not for the terminal of the study
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    try:
        outcome = run_task(task)
    except Exception as error:  # noqa: BLE001 - a bug, too, is the reason why one trial failed
        reason = f"{type(error).__name__}: {one_line(error)}"
        outcome = task.outcome(reason=reason)
    channel.send(outcome, _END_S)


def _end_with_parent(channel: Channel) -> None:
    try:
        while True:
            channel.wait(_LOOK_S)
            channel.receive()
    except ChannelClosed:
        os._exit(1)


def run_on_cluster(task: Task) -> Outcome:
    """In a process of its own, which a worker of a cluster waits for."""
    [outcome] = outcomes_here([task], 1)
    return outcome


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
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise DependencyError("a scheduler needs Dask: pip install 'posefuse[cluster]'") from None
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise InputError(f"`scheduler={address}`: no Dask scheduler answers there ({error or 'timeout'})") from None
    with client:
        _check_workers(client, address)
        # the scheduler forgets a task as soon as no future of it is left
        by_key = {f"posefuse-{task.trial.name}-{task.made_with}": task for task in tasks}
        futures = [client.submit(run_on_cluster, task, key=key, retries=_RETRIES) for key, task in by_key.items()]
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                yield _outcome_of(by_key[future.key], future)
        finally:
            client.cancel(futures)


def _outcome_of(task: Task, future: Any) -> Outcome:
    if future.status == "finished":
        outcome: Outcome = future.result()
        return outcome
    reason = f"the cluster gave it up: {future.exception()}" if future.status == "error" else f"the cluster {future.status} it"
    return task.outcome(reason=" ".join(reason.split()))


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

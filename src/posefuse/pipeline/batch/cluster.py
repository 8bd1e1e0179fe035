"""Trials on an existing Dask cluster (extra `cluster`): its workers see the same folders and have the same posefuse."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from posefuse import __version__
from posefuse.core import DependencyError, InputError

from .processes import run_in_process
from .tasks import Outcome, Task

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
                yield _outcome(names[future.key], future)
        finally:
            client.cancel(futures)


def _outcome(task: Task, future: Any) -> Outcome:
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

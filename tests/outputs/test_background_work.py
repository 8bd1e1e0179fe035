"""Work in a thread of its own: in order, bounded, and its errors are not lost."""

from __future__ import annotations

import threading

import pytest

from posefuse.outputs.overlay import Background


def test_calls_are_made_in_order_in_another_thread() -> None:
    done: list[tuple[int, int]] = []
    work = Background(lambda i: done.append((i, threading.get_ident())), "test")
    for i in range(20):
        work.call(i)
    work.close()
    work.close()
    assert [i for i, _ in done] == list(range(20))
    assert threading.get_ident() not in {thread for _, thread in done}


def test_the_caller_waits_while_too_many_calls_wait() -> None:
    begin, most = threading.Event(), threading.Event()
    work = Background(lambda: begin.wait(10), "test")

    def call_four() -> None:
        for _ in range(4):
            work.call()
        most.set()

    caller = threading.Thread(target=call_four)
    caller.start()
    assert not most.wait(0.2)
    begin.set()
    assert most.wait(10)
    caller.join(10)
    work.close()


@pytest.mark.parametrize("later_calls", [0, 8])
def test_an_error_reaches_the_caller(later_calls: int) -> None:
    done: list[int] = []

    def write(i: int) -> None:
        if i == 0:
            raise OSError("the disk is full")
        done.append(i)

    work = Background(write, "test")
    with pytest.raises(OSError, match="full"):
        try:
            for i in range(later_calls + 1):
                work.call(i)
        finally:
            work.close()
    assert len(done) < 8

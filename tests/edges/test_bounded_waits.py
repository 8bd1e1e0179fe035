"""No test waits without a limit: a machine that stalls makes a failure with a reason, never a run that hangs."""

import ast
import sys
import time
from pathlib import Path

import pytest
from running import Lines, Running

TESTS = Path(__file__).resolve().parents[1]
FILES = sorted(TESTS.rglob("*.py"))
# methods that wait for another process or thread, and how many arguments they take with the limit
WAITING = {"communicate": 2, "wait": 1, "join": 1}
STREAMS = ("stdout", "stderr")
SAYS_AND_STAYS = [sys.executable, "-u", "-c", "import time; print('hello'); time.sleep(60)"]


def unbounded(path: Path) -> list[str]:
    """Calls that may wait for ever, with their lines."""
    found = []
    tree = ast.parse(path.read_text(encoding="utf-8"))
    limited = {id(call.args[0]) for call in ast.walk(tree) if isinstance(call, ast.Call) and _is_wait_for(call)}
    for node in ast.walk(tree):
        if id(node) in limited:
            continue
        if isinstance(node, ast.For | ast.comprehension):
            waits = isinstance(node.iter, ast.Attribute) and node.iter.attr in STREAMS
            node = node.iter
        else:
            waits = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and waits_for_ever(node)
        if waits:
            found.append(f"{path.name}:{node.lineno}: {ast.unparse(node)[:80]}")
    return found


def _is_wait_for(call: ast.Call) -> bool:
    return ast.unparse(call.func) == "asyncio.wait_for" and len(call.args) + len(call.keywords) > 1 and bool(call.args)


def waits_for_ever(call: ast.Call) -> bool:
    if any(word.arg == "timeout" for word in call.keywords):
        return False
    name = call.func.attr
    return name == "readline" or ast.unparse(call.func) == "subprocess.run" or len(call.args) < WAITING.get(name, 0)


def test_every_wait_for_a_process_or_thread_has_a_limit() -> None:
    assert FILES and [wait for path in FILES for wait in unbounded(path)] == []


def test_the_guard_sees_waits_without_a_limit_and_lets_limited_ones_pass(tmp_path: Path) -> None:
    path = tmp_path / "x.py"
    for_ever = ("p.wait()", "p.communicate()", "t.join()", "q.readline()", "subprocess.run(['x'])", "[x for x in p.stdout]")
    limited = ("p.wait(3)", "p.communicate(timeout=3)", "t.join(9.0)", "', '.join(x)", "subprocess.run(x, timeout=3)")
    for codes, found in ((for_ever, 1), (limited, 0)):
        for code in codes:
            path.write_text(f"{code}\n")
            assert len(unbounded(path)) == found, code


def test_a_line_that_never_comes_is_waited_for_no_longer_than_said() -> None:
    with Running(SAYS_AND_STAYS) as running:
        assert running.out.wait_for("hel+o")[0] == "hello"
        began_s = time.monotonic()
        with pytest.raises(AssertionError, match=r"'bye' did not come within 0.3 s in: hello"):
            running.out.wait_for("bye", 0.3)
        assert time.monotonic() - began_s < 30
        with pytest.raises(AssertionError, match=r"still running after 0.1 s"):
            running.finished(0.1)


def test_the_end_of_the_output_ends_the_wait() -> None:
    with Running([sys.executable, "-c", "print('one'); print('two')"]) as running:
        with pytest.raises(AssertionError, match="'three' never came; the output ended: one\ntwo"):
            running.out.wait_for("three")
        assert running.finished() == ("one\ntwo\n", "")
        assert running.process.returncode == 0
    assert isinstance(running.out, Lines)

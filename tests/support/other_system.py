"""Makes Python look to posefuse like Python of another system: imported as `sitecustomize` by every process of a test.

Names that the standard library of that system does not have (typeshed knows them: mypy brings it) are missing for code of
posefuse and there for everybody else, so that the standard library and other packages continue working. POSEFUSE_TEST_SYSTEM says
which system: a value of `sys.platform`.
"""

import ast
import builtins
import ctypes
import importlib.util
import os
import socket
import sys
import types
from pathlib import Path

MODULES = ("os", "signal", "socket", "time", "resource", "fcntl", "pwd", "grp", "termios", "syslog")
SYSTEM = os.environ.get("POSEFUSE_TEST_SYSTEM", "")
# of Linux: a copy of a file of another process
_LIBC = ctypes.CDLL(None) if os.name == "posix" else None
_PIDFD_OPEN, _PIDFD_GETFD, _SET_PTRACER = 434, 438, 0x59616D61
_frame = sys._getframe  # asked for before `sys` itself is disguised


def lacking(module: str, system: str) -> set[str]:
    """Names that the module has on Linux and not on `system`."""
    return names_of(module, "linux") - names_of(module, system)


def names_of(module: str, system: str) -> set[str]:
    """Names that a module of the standard library has on a system, of any Python version."""
    stubs = Path(importlib.util.find_spec("mypy").origin).parent / "typeshed" / "stdlib"
    files = [stubs / f"{module}.pyi", stubs / module / "__init__.pyi", stubs / f"_{module}.pyi"]
    found = set()
    for file in files:
        if file.is_file():
            found |= set(_names(ast.parse(file.read_text(encoding="utf-8")).body, system))
    return {name for name in found if not name.startswith("_")}


def _names(body, system):
    for node in body:
        if isinstance(node, ast.If):
            holds = _holds(node.test, system)
            yield from _names(node.body if holds else [], system)
            yield from _names(node.orelse if holds is not True else [], system)
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
            if isinstance(node, ast.ClassDef) and any("Enum" in ast.unparse(base) for base in node.bases):
                yield from _names(node.body, system)
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target)
        elif isinstance(node, ast.Assign):
            yield from (ast.unparse(target) for target in node.targets)


def _holds(test, system):
    """True or False for conditions about the system, None (either) for those about the version of Python."""
    text = ast.unparse(test)
    if isinstance(test, ast.BoolOp):
        parts = [_holds(value, system) for value in test.values]
        decided = isinstance(test.op, ast.Or)
        return decided if decided in parts else None if None in parts else not decided
    if text.startswith("sys.platform"):
        return bool(eval(text, {"sys": types.SimpleNamespace(platform=system)}))
    return None


class _Seen(types.ModuleType):
    """A module of which posefuse cannot see everything, and some things differently."""

    def __getattribute__(self, name):
        get = super().__getattribute__
        asking = _frame(0).f_back  # None: the interpreter itself
        if name.startswith("__") or asking is None or not asking.f_globals.get("__name__", "").startswith("posefuse"):
            return get(name)
        seen = get("__dict__").get("_seen_by_posefuse", {})
        if name in seen:
            if seen[name] is None:
                raise AttributeError(f"module {get('__name__')!r} has no attribute {name!r} on {SYSTEM}")
            return seen[name]
        return get(name)


def _loopback_pair(*arguments):
    """`socket.socketpair` of Windows; macOS has it, but not for packets."""
    if SYSTEM == "darwin":
        if arguments[1:2] == (socket.SOCK_SEQPACKET,):
            raise OSError(43, "Protocol not supported")
        return socket.socketpair(*arguments)
    with socket.create_server(("127.0.0.1", 0)) as server:
        one = socket.create_connection(server.getsockname())
        return one, server.accept()[0]


def _share(shared, pid):
    """`socket.socket.share` of Windows: text by which another process gets a copy of the socket."""
    _LIBC.prctl(_SET_PTRACER, ctypes.c_ulong(-1), 0, 0, 0)  # that process is not root, maybe
    return f"{os.getpid()} {os.dup(shared.fileno())}".encode()


def _from_share(text):
    """`socket.fromshare` of Windows."""
    pid, file = map(int, text.split())
    return socket.socket(fileno=_LIBC.syscall(_PIDFD_GETFD, _LIBC.syscall(_PIDFD_OPEN, pid, 0), file, 0))


class _AnyLibrary:
    """Stands for a library of Windows: every function is there and does nothing."""

    def __init__(self, name):
        self.name = name

    def __getattr__(self, name):
        function = lambda *arguments: 0  # noqa: E731
        self.__dict__[name] = function
        return function


def install():
    """From here on, posefuse sees the other system."""
    missing = {module: lacking(module, SYSTEM) for module in MODULES}
    gone = {module for module in MODULES if missing[module] and not names_of(module, SYSTEM) - {"sys"}}
    seen = {module: dict.fromkeys(names) for module, names in missing.items() if module not in gone}
    seen["socket"]["socketpair"] = _loopback_pair
    seen["sys"] = {"platform": SYSTEM}
    for module, names in seen.items():
        there = importlib.import_module(module)
        there.__dict__["_seen_by_posefuse"] = names
        there.__class__ = _Seen
    if SYSTEM == "win32":
        vars(ctypes)["WinDLL"] = _AnyLibrary
        setattr(socket.socket, "share", _share)  # noqa: B010
        seen["socket"]["fromshare"] = _from_share
    original = builtins.__import__

    def importing(name, globals=None, *arguments, **others):
        if name in gone and (globals or {}).get("__name__", "").startswith("posefuse"):
            raise ModuleNotFoundError(f"No module named {name!r} on {SYSTEM}", name=name)
        return original(name, globals, *arguments, **others)

    builtins.__import__ = importing


if SYSTEM and __name__ == "sitecustomize":
    install()

"""What all public functions share: arguments checked by their annotations, and ``progress=``."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from math import isfinite
from numbers import Integral, Real
from typing import Any, Literal, ParamSpec, TypeVar, get_args, get_origin

import numpy as np

from posefuse.core import InputError, Progress, silent

P = ParamSpec("P")
R = TypeVar("R")

# annotation -> what is expected, and whether a value is that
_EXPECTED: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "bool": ("True or False", lambda value: isinstance(value, bool | np.bool_)),
    "int": ("a whole number", lambda value: isinstance(value, Integral) and not isinstance(value, bool)),
    "float": ("a number", lambda value: isinstance(value, Real) and not isinstance(value, bool | np.bool_)),
    "Sequence[str]": ("a list of names", lambda value: not isinstance(value, str) and all(isinstance(one, str) for one in value)),
    "Mapping[str, float]": (
        "finite numbers by name",
        lambda value: isinstance(value, Mapping) and all(isinstance(one, Real) and isfinite(one) for one in value.values()),
    ),
    "Mapping[str, Any]": ("settings by dotted key, {'KEY': VALUE}", lambda value: isinstance(value, Mapping)),
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that raises InputError, naming the argument, for a value of another kind than its annotation states.

    Annotations are compared as text: flags, numbers, lists of names, mappings of settings and names of a `Literal` in the
    function's module, each also with ``| None``.
    """
    annotations = {name: str(one.annotation) for name, one in signature(function).parameters.items()}
    module = vars(sys.modules[function.__module__])

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in {**dict(zip(annotations, args, strict=False)), **kwargs}.items():
            kind, _, none = annotations.get(name, "").partition(" | ")
            known = _one_of(module.get(kind)) or _EXPECTED.get(kind)
            if known is None or none not in ("", "None") or (none and value is None):
                continue
            expected, fits = known
            if not fits(value):
                hint = f"; its settings are given as settings={{'{name}.KEY': VALUE}}" if isinstance(value, Mapping) else ""
                raise InputError(f"{function.__name__}: {name}: expected {expected}, got {value!r}{hint}")
        return function(*args, **kwargs)

    return call


def _one_of(words: Any) -> tuple[str, Callable[[Any], bool]] | None:
    """As in `_EXPECTED` for a `Literal`; None for anything else."""
    if get_origin(words) is not Literal:
        return None
    return f"one of {', '.join(get_args(words))}", lambda value: isinstance(value, str) and value in get_args(words)


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress]:
    """The function to report to: the one given, bars on stderr for True, or one that shows nothing for None and False."""
    if progress is None or progress is False:
        yield silent
    elif progress is True:
        from rich.console import Console

        from posefuse.foundation.progress_bars import stage_bars

        console = Console(file=sys.stderr, highlight=False, soft_wrap=True)
        with stage_bars(console, lambda line: console.print(line, markup=False)) as report:
            yield report
    else:
        yield progress


def lines_of(progress: Progress, stage: str) -> Callable[[str], None]:
    """What takes lines of news for a stage."""
    return lambda line: progress(stage, 0, None, line)

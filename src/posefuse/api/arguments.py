"""Arguments of the public functions, checked by their annotations before any work: what would be ignored is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar

import numpy as np

from posefuse.core import InputError

P = ParamSpec("P")
R = TypeVar("R")

# annotation -> what is expected, and whether a value is that
_EXPECTED: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "bool": ("True or False", lambda value: isinstance(value, bool | np.bool_)),
    "int": ("a whole number", lambda value: isinstance(value, Integral) and not isinstance(value, bool)),
    "float": ("a number", lambda value: isinstance(value, Real) and not isinstance(value, bool | np.bool_)),
    "Sequence[str]": ("a list of names", lambda value: not isinstance(value, str) and all(isinstance(one, str) for one in value)),
    "Mapping[str, Any]": ("settings by dotted key, {'KEY': VALUE}", lambda value: isinstance(value, Mapping)),
}


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that raises InputError, naming the argument, for a value of another kind than its annotation states.

    Looks at keyword arguments. Annotations are compared as text: flags, numbers, lists of names and mappings of settings, each
    also with ``| None``.
    """
    annotations = {name: str(one.annotation) for name, one in signature(function).parameters.items()}

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in kwargs.items():
            kind, _, none = annotations.get(name, "").partition(" | ")
            if kind not in _EXPECTED or none not in ("", "None") or (none and value is None):
                continue
            expected, fits = _EXPECTED[kind]
            if not fits(value):
                hint = f"; its settings are given as settings={{'{name}.KEY': VALUE}}" if isinstance(value, Mapping) else ""
                raise InputError(f"{function.__name__}: {name}: expected {expected}, got {value!r}{hint}")
        return function(*args, **kwargs)

    return call

"""What is asked of many values: that a refusal is one line, and that two values are the same in every field."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pytest


def refusal(
    error: type[Exception] | tuple[type[Exception], ...], words: str, call: Callable[..., Any], /, *given: Any, **options: Any
) -> str:
    """The one line, in which the regular expression `words` is found, that a call is refused with."""
    with pytest.raises(error, match=words) as caught:
        call(*given, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def assert_same(one: Any, other: Any, atol: float = 0.0, where: str = "value") -> None:
    """Both are of one type and equal in every field, floats to `atol` (0: to the last bit, and of one dtype); NaN equals NaN."""
    assert type(one) is type(other), where
    if is_dataclass(one) and not isinstance(one, type):
        for name in [field.name for field in fields(one)]:
            assert_same(getattr(one, name), getattr(other, name), atol, f"{where}.{name}")
    elif isinstance(one, Mapping):
        assert list(one) == list(other), where
        for key in one:
            assert_same(one[key], other[key], atol, f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for i, pair in enumerate(zip(one, other, strict=True)):
            assert_same(*pair, atol, f"{where}[{i}]")
    elif isinstance(one, (np.ndarray, float)):
        assert atol or np.asarray(one).dtype == np.asarray(other).dtype, where
        np.testing.assert_allclose(one, other, rtol=0, atol=atol, err_msg=where)
    else:
        assert one == other, where

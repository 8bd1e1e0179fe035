"""Arrays that are checked once and can no longer be written."""

from collections.abc import Iterable, Mapping
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .errors import ShapeError

Array = NDArray[Any]


def frozen(value: Any, dtype: DTypeLike, name: str) -> Array:
    """`value` as a read-only, contiguous array of its own; raises ShapeError when it is not numeric.

    An array that this function returned before, or whole rows of one, is not copied again: it can no longer be written.
    """
    if _is_frozen(value, dtype):
        return np.asarray(value)
    try:
        array = np.array(value, dtype=dtype, order="C")
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name}: expected an array of {np.dtype(dtype)}, got {type(value).__name__} ({error})") from None
    array.setflags(write=False)
    return array


def give_away(*arrays: Array) -> None:
    """Make arrays of one's own read-only, so that a value takes them as they are: a copy of an hour would take much memory."""
    for array in arrays:
        array.setflags(write=False)
        if type(array.base) is np.ndarray:
            give_away(array.base)


def take_back(*arrays: Array) -> None:
    """Make arrays that were given away writeable again, once no value is read any more that has them."""
    for array in arrays:
        if type(array.base) is np.ndarray:
            take_back(array.base)
        array.setflags(write=True)


class FrozenArrays:
    """Base of values whose arrays are `frozen`: those of a copy (`copy.deepcopy`, `pickle`) cannot be written either.

    NumPy makes them writeable again, but what is derived from them is kept and would no longer fit.
    """

    def __setstate__(self, state: dict[str, Any]) -> None:
        give_away(*(one for one in state.values() if type(one) is np.ndarray))
        self.__dict__.update(state)


def _is_frozen(value: Any, dtype: DTypeLike) -> bool:
    if type(value) is not np.ndarray or value.dtype != dtype or not value.flags.c_contiguous:
        return False
    # of a view, the array behind it may still be written
    while type(value) is np.ndarray and not value.flags.writeable:
        value = value.base
    return value is None


def taken(value: Any, names: Iterable[str], places: Any) -> dict[str, Any]:
    """These fields of a value at these places of their axes, by name; one that is None stays so."""
    return {name: None if (array := getattr(value, name)) is None else array[places] for name in names}


def known_median(values: Array, unknown: float = float("nan")) -> float:
    """Median of the finite values; `unknown` where there is none."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else unknown


def sample_sd(values: Array) -> Array:
    """Standard deviation over axis 0, of all that the values are a sample of (n - 1, as statistics programs); 0 for one value."""
    return np.asarray(np.std(values, axis=0, ddof=min(1, len(values) - 1)))


def median_apart(one: Array, other: Array) -> float:
    """Median distance of points (K, 3) that both have; infinite where there is none."""
    return known_median(np.linalg.norm(one - other, axis=-1), np.inf)


# standard deviation of a normal distribution from its median absolute deviation
SIGMA_PER_MAD = 1.4826
# median of a chi-square of 3 degrees of freedom
MEDIAN_CHI2 = 2.366


def freeze_fields(value: Any, dtypes: Mapping[str, DTypeLike]) -> None:
    """Make the named fields of a frozen dataclass `frozen` arrays; for its ``__post_init__``."""
    for name, dtype in dtypes.items():
        object.__setattr__(value, name, frozen(getattr(value, name), dtype, f"{type(value).__name__}.{name}"))


def frozen_fields(value: Any, axes: Mapping[str, str], dtypes: Mapping[str, DTypeLike] = MappingProxyType({})) -> dict[str, int]:
    """`freeze_fields` and `check_axes` of the fields that `axes` names.

    Times in ns and ids (by the ends of their names) are int64, others float64, where `dtypes` does not have another type.
    """
    kinds = {name: np.int64 if name.endswith(("_ns", "_id")) else np.float64 for name in axes}
    freeze_fields(value, {**kinds, **dtypes})
    return check_axes(type(value).__name__, {name: (getattr(value, name), text) for name, text in axes.items()})


def check_axes(owner: str, arrays: Mapping[str, tuple[Array, str]]) -> dict[str, int]:
    """Check that axes of the same letter have the same size over all arrays; returns the size of each.

    `arrays` maps a field name to (array, axes), axes as in ``"P K 2"``: a number is an exact size.
    """
    sizes: dict[str, int] = {}
    for field, (array, axes) in arrays.items():
        wanted = _parsed(axes)
        if array.ndim != len(wanted):
            raise ShapeError(f"{owner}.{field}: expected axes ({', '.join(axes.split())}), got shape {array.shape}")
        for (axis, exact), size in zip(wanted, array.shape, strict=True):
            expected = sizes.setdefault(axis, size) if exact is None else exact
            if size != expected:
                raise ShapeError(f"{owner}.{field}: expected axis {axis} of size {expected}, got shape {array.shape}")
    return sizes


@cache
def _parsed(axes: str) -> tuple[tuple[str, int | None], ...]:
    """Each axis with its exact size, None where a letter stands for it."""
    return tuple((axis, int(axis) if axis.isdigit() else None) for axis in axes.split())

"""Text, TOML, JSON and YAML of a user's files to plain values: whatever is in them, one clear error and bounded work."""

from __future__ import annotations

import json
import math
import reprlib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import InputError

# YAML aliases can expand a few lines to 9^9 values; no settings or calibration file has nearly this number of values
MOST_YAML_VALUES = 1_000_000
# larger integers become floating point, as in other JSON readers; nanoseconds since 1970 have 19 digits
_MOST_DIGITS, _MOST_INTEGER = 20, 2**63 - 1
# longest part of a value in a message, and longest message of a library, characters
_MOST_SHOWN, _MOST_SAID = 100, 400


def read_text(path: Path, error: type[InputError] = InputError) -> str:
    """The UTF-8 text of a file, without a byte order mark; raises `error` when it cannot be read or is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except IsADirectoryError:
        raise error(f"{path}: is a folder; expected a file") from None
    except UnicodeDecodeError as problem:
        raise error(f"{path}: cannot be read as text ({problem}); save it as UTF-8") from None
    except OSError as problem:
        raise error(f"{path}: cannot be read as text ({problem})") from None


def read_bytes(path: Path) -> bytes:
    """The content of a file; raises InputError when it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as problem:
        raise InputError(f"{path}: cannot be read ({problem.strerror})") from None


def parse_toml(where: str, text: str, error: type[InputError] = InputError) -> dict[str, Any]:
    """The tables of a TOML text; raises `error` in one line when it is not TOML."""
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError, OverflowError) as problem:
        raise error(f"{where}: cannot be parsed as TOML ({one_line(problem)})") from None


def parse_json(where: str, text: str | bytes, error: type[InputError] = InputError) -> Any:
    """The value of a JSON text; integers beyond 64 bits become floats. Raises `error` in one line when it is not JSON."""
    try:
        return json.loads(text, parse_int=_json_integer)
    except (ValueError, RecursionError) as problem:
        raise error(f"{where}: cannot be parsed as JSON ({one_line(problem)})") from None


def parse_yaml(where: str, text: str, error: type[InputError] = InputError) -> Any:
    """The value of a YAML text with at most `MOST_YAML_VALUES` values, aliases counted each time they are used.

    Raises:
        error: not YAML, more values than that, or a value that contains itself; one line.
    """
    import yaml  # the help of no command needs it

    try:
        value = yaml.safe_load(text)
        count = _value_count(value, {})
    except (yaml.YAMLError, ValueError, TypeError, AttributeError, RecursionError, OverflowError) as problem:
        raise error(f"{where}: cannot be parsed as YAML ({one_line(problem)})") from None
    if count > MOST_YAML_VALUES:
        raise error(f"{where}: its aliases stand for {count:.3g} values; expected at most {MOST_YAML_VALUES}")
    return value


def _json_integer(digits: str) -> int | float:
    # an integer of thousands of digits takes long to read
    value = int(digits) if len(digits) <= _MOST_DIGITS else None
    return value if value is not None and -_MOST_INTEGER - 1 <= value <= _MOST_INTEGER else float(digits)


def _value_count(value: Any, known: dict[int, int]) -> int:
    """Values below this one, with aliases written out; each shared value is looked at once."""
    if not isinstance(value, dict | list):
        return 1
    if id(value) in known:
        if not known[id(value)]:
            raise ValueError("a value contains itself")
        return known[id(value)]
    known[id(value)] = 0
    inner = value.values() if isinstance(value, dict) else value
    known[id(value)] = 1 + sum(_value_count(part, known) for part in inner)
    return known[id(value)]


def one_line(problem: BaseException | str) -> str:
    """The message of an exception on one line of limited length."""
    if isinstance(problem, RecursionError):
        return "nested too deeply"
    text = " ".join(str(problem).split()) or type(problem).__name__
    return text if len(text) <= _MOST_SAID else f"{text[:_MOST_SAID]}..."


def ros_name(text: str) -> str:
    """`text` as one part of a ROS name: letters, digits and underscores, not starting with a digit."""
    cleaned = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in text) or "_"
    return f"_{cleaned}" if cleaned[0].isdigit() else cleaned


def short(value: Any) -> str:
    """The value on one line of a few words, whatever its size: a few lines of YAML can stand for 9^9 values."""
    shown = reprlib.Repr()
    shown.maxstring = shown.maxother = shown.maxlong = _MOST_SHOWN
    return " ".join(shown.repr(value).split())


# Values as plain JSON: what results, logs and `--json` write.


def plain(value: Any) -> Any:
    """Plain JSON values of figures: arrays to lists, paths to text, NaN to null."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    # the help of commands reads settings, and needs no NumPy
    import numpy as np

    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value

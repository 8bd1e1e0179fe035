"""Settings files (TOML, YAML) to frozen dataclasses, with errors that name the file, the key and what is allowed."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, dataclass_transform, get_args, get_type_hints

from posefuse.core import ConfigError
from posefuse.core.errors import choices

from .parsing import one_line, parse_toml, parse_yaml, read_text, short

if TYPE_CHECKING:
    from pydantic import ValidationError

T = TypeVar("T")
# a file with more unknown keys and no known one is another file, not one with typing errors
_TYPING_ERRORS = 2
_STRICT = {"extra": "forbid", "allow_inf_nan": False}


@dataclass_transform(frozen_default=True, kw_only_default=True)
def settings(cls: type[T]) -> type[T]:
    """Class decorator: a frozen keyword-only dataclass whose every key is validated by `settings_from_mapping`.

    Put ranges and units in ``Annotated[float, Gt(0)]`` and in the field's name.
    """
    made = dataclasses.dataclass(frozen=True, kw_only=True)(cls)
    made.__pydantic_config__ = _STRICT  # type: ignore[attr-defined]
    return made


def read_settings(path: Path, cls: type[T]) -> T:
    """Read a .toml, .yaml or .yml file; raises ConfigError in one line for anything that is not right in it."""
    content = read_mapping(path)
    known = [field.name for field in dataclasses.fields(cls)]  # type: ignore[arg-type]
    if len(content) > _TYPING_ERRORS and not set(content) & set(known):
        got = choices(map(str, content))
        raise ConfigError(f"{path}: this is another kind of file: expected keys among {choices(known)}, got {got}")
    return settings_from_mapping(content, cls, where=str(path))


def read_mapping(path: Path) -> dict[str, Any]:
    """The raw content of a .toml, .yaml or .yml file, a mapping at the top."""
    parse = parse_toml if path.suffix == ".toml" else parse_yaml
    content = parse(str(path), read_text(path, ConfigError), ConfigError)
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: expected keys with values at the top, got {type(content).__name__}")
    return content


def settings_from_mapping(content: Mapping[str, Any], cls: type[T], where: str) -> T:
    """Validate plain values into a `settings` class; `where` names the origin in errors."""
    from pydantic import TypeAdapter, ValidationError

    try:
        return TypeAdapter(cls).validate_python(content)
    except ValidationError as error:
        raise ConfigError(f"{where}: {_first_problem(error, cls)}") from None
    except (TypeError, ValueError, RecursionError) as error:
        # pydantic itself refuses, e.g., keys that are no text
        raise ConfigError(f"{where}: expected names as keys ({one_line(error)})") from None


def _first_problem(error: ValidationError, cls: type[Any]) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "unexpected_keyword_argument":
        return f"unknown key {short(key)}; there are: {choices(_sibling_names(cls, first['loc']))}"
    if first["type"] in ("missing_argument", "missing_keyword_only_argument", "missing"):
        return f"{key}: missing"
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    # pydantic puts "Value error, " before what our own validators say
    said = str(first["ctx"]["error"]) if first["type"] == "value_error" else first["msg"]
    return f"{key}: {said[0].lower()}{said[1:]}, got {short(first['input'])}{more}"


def _sibling_names(cls: type[Any], loc: tuple[str | int, ...]) -> list[str]:
    """Names allowed in place of the unknown key: follow the path down through nested settings as far as it is clear."""
    here: Any = cls
    for part in loc[:-1]:
        for candidate in _settings_inside(here):
            types = {f.name: f.type for f in dataclasses.fields(candidate)}
            if part in types:
                here = _resolved(candidate, str(part))
                break
            # of several kinds, pydantic names a class or its tag
            if part == candidate.__name__ or any(part in get_args(hint) for hint in get_type_hints(candidate).values()):
                here = candidate
                break
    return sorted({f.name for candidate in _settings_inside(here) for f in dataclasses.fields(candidate)})


def _resolved(cls: type[Any], name: str) -> Any:
    return get_type_hints(cls)[name]


def _settings_inside(annotation: Any) -> list[type[Any]]:
    """The settings classes an annotation can stand for (through unions, lists, dicts and Annotated)."""
    if isinstance(annotation, type) and dataclasses.is_dataclass(annotation):
        return [annotation]
    return [found for part in get_args(annotation) for found in _settings_inside(part)]


def described(cls: type[Any]) -> tuple[str, dict[str, str]]:
    """The contents of a docstring: the text above ``Attributes:``, and the meaning of each attribute by name.

    Several attributes may share a line: ``a, b: both. c: another.``
    """
    inherited: dict[str, str] = {}
    for base in reversed(cls.__mro__[1:]):
        if dataclasses.is_dataclass(base):
            inherited |= described(base)[1]
    text = inspect.cleandoc(vars(cls).get("__doc__") or "")
    if text.startswith(f"{cls.__name__}("):
        text = ""  # made by `dataclass`, where there is none
    about, _, rest = text.partition("\nAttributes:\n")
    rest = " ".join(line.strip() for line in re.split(r"\n(?=\S)", rest)[0].splitlines())
    names = {one.name for one in dataclasses.fields(cls)}
    one = "|".join(map(re.escape, sorted(names, key=len, reverse=True))) or r"(?!)"
    found = list(re.finditer(rf"(?:(?<=^)|(?<=[.;] )|(?<=\) ))((?:{one})(?:, (?:{one}))*): ", rest))
    meanings = inherited
    for place, match in enumerate(found):
        end = found[place + 1].start() if place + 1 < len(found) else len(rest)
        for name in match.group(1).split(", "):
            meanings[name] = rest[match.end() : end].strip()
    return about.strip(), meanings


class Setting(NamedTuple):
    """A setting as its class states it: options of commands and fields of pages are made from it.

    Attributes:
        type: without, annotated: with what `Annotated` has. default: ``MISSING`` where there is none. help: its meaning.
    """

    type: Any
    annotated: Any
    default: Any
    help: str


def setting_of(cls: type[Any], key: str) -> Setting:
    """The setting with a dotted key."""
    *groups, name = key.split(".")
    for one in groups:
        cls = _resolved(cls, one)
    [field] = [field for field in dataclasses.fields(cls) if field.name == name]
    annotated = get_type_hints(cls, include_extras=True)[name]
    return Setting(_resolved(cls, name), annotated, field.default, described(cls)[1].get(name, ""))

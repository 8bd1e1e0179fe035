"""The settings reference, from the settings classes: key, type, range, default and the text of the docstring."""

from __future__ import annotations

import dataclasses
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from posefuse.foundation.plugins import list_plugins
from posefuse.foundation.settings import described
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.realtime.config import LiveConfig

ROOTS: tuple[tuple[str, str, type[Any]], ...] = (
    ("track", "`posefuse track`, in `SESSION/posefuse.toml`, with `--config FILE` or `--set KEY=VALUE`", TrackConfig),
    ("live", "`posefuse live` and `posefuse node`, with `--config FILE` or `--set KEY=VALUE`", LiveConfig),
)
PLUGINS: tuple[tuple[str, str, str], ...] = (
    ("detectors", "Detectors", "Set as `detector.name` and `detector.options.KEY`."),
    ("sources", "Sources", "Options of cameras and files, for programs that build sources themselves."),
    ("outputs", "Outputs of recordings", "Chosen by name with `--outputs`."),
    ("live_outputs", "Live outputs", "Set as `outputs.NAME.KEY`."),
)
_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<"}


def settings_page() -> str:
    """Markdown: a table per group of settings."""
    parts = [
        "# Settings\n",
        "This page is generated from the code. A settings file is TOML or YAML; a dotted key such as `smooth.cutoff_hz` is "
        "the key `cutoff_hz` in the table `[smooth]`. An unknown key or a value out of range is refused in one line that names "
        "the file, the key and what is allowed. From Python the same keys go into `settings={...}`.\n",
    ]
    for name, where, root in ROOTS:
        parts.append(f"## Settings of {name}\n\nFor {where}.\n")
        for prefix, cls in _groups(root):
            parts.append(_table(prefix, cls))
    for group, title, about in PLUGINS:
        parts.append(f"## {title}\n\n{about}\n")
        parts += [
            _table(plugin.name, plugin.config)
            for plugin in list_plugins(group)
            if plugin.config and plugin.package in ("posefuse", "posefuse-ros", "posefuse-sim")
        ]
    return "\n".join(parts)


def _groups(cls: type[Any], prefix: str = "") -> Iterator[tuple[str, type[Any]]]:
    """The class and the settings classes inside it, each with its dotted prefix."""
    yield prefix, cls
    for name, hint in get_type_hints(cls).items():
        if name in _field_names(cls) and dataclasses.is_dataclass(hint):
            yield from _groups(hint, f"{prefix}{name}.")
    if cls is TrackConfig:
        yield "cameras.NAME.", CameraInput


def _table(prefix: str, cls: type[Any]) -> str:
    about, meanings = described(cls)
    title = f"`{prefix.rstrip('.')}`" if prefix else "Top level"
    lines = [f"### {title}\n", f"{about}\n"]
    fields = [one for one in dataclasses.fields(cls) if not dataclasses.is_dataclass(_hints(cls)[one.name])]
    if not fields:
        return "\n".join([*lines, "No options.\n"])
    lines.append("| key | type | default | meaning |\n|---|---|---|---|")
    for one in fields:
        kind, bounds = _type_text(_hints(cls, extras=True)[one.name])
        shown = f"{kind} {bounds}".strip().replace("|", "\\|")
        lines.append(f"| `{one.name}` | {shown} | {_default(one)} | {meanings.get(one.name, '').replace('|', chr(92) + '|')} |")
    return "\n".join([*lines, ""])


def _field_names(cls: type[Any]) -> set[str]:
    return {one.name for one in dataclasses.fields(cls)}


def _hints(cls: type[Any], extras: bool = False) -> dict[str, Any]:
    return get_type_hints(cls, include_extras=extras)


def _type_text(hint: Any) -> tuple[str, str]:
    """A type and its range in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin is Annotated:
        kind, bounds = _type_text(inner[0])
        stated = [f"{sign} {getattr(part, key):g}" for part in inner[1:] for key, sign in _BOUNDS.items() if hasattr(part, key)]
        return kind, ", ".join([*([bounds] if bounds else []), *stated])
    if origin in (Union, types.UnionType):
        parts = [_type_text(one) for one in inner if one is not type(None)]
        return " or ".join(kind for kind, _ in parts), " ".join(bounds for _, bounds in parts if bounds)
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in inner), ""
    if origin in (tuple, list):
        kinds = [_type_text(one)[0] for one in inner if one is not Ellipsis]
        return f"list of {kinds[0]}" if Ellipsis in inner or origin is list else f"{len(kinds)} x {kinds[0]}", ""
    if origin is dict:
        return "table", ""
    names = {"float": "number", "int": "whole number", "str": "text", "bool": "true or false", "Path": "path"}
    return names.get(getattr(hint, "__name__", str(hint)), getattr(hint, "__name__", str(hint))), ""


def _default(one: dataclasses.Field[Any]) -> str:
    if one.default is not dataclasses.MISSING:
        value = one.default
    elif one.default_factory is not dataclasses.MISSING:
        value = one.default_factory()
    else:
        return "required"
    if value is None or value in ((), {}, ""):
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, tuple | list):
        return ", ".join(f"`{part}`" for part in value)
    return f"`{value:g}`" if isinstance(value, float) else f"`{value}`"

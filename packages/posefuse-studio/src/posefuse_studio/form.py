"""Fields of a page for settings: type, range, help and default come from the settings class, as those of options do."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from annotated_types import Ge, Le
from nicegui import ui

from posefuse.foundation.settings import setting_of


def setting_fields(
    cls: type[Any], named: Mapping[str, str], values: Mapping[str, Any] | None = None
) -> Callable[[], dict[str, Any]]:
    """Place a field for each setting named.

    Args:
        named: label by dotted key. values: to begin with, where they are not the defaults.

    Returns:
        Gives what was set by dotted key: what ``settings=`` of the public functions takes.
    """
    fields: dict[str, Any] = {}
    for key, label in named.items():
        setting = setting_of(cls, key)
        fields[key] = _field(setting.annotated, label, (values or {}).get(key, setting.default)).tooltip(setting.help)
    return lambda: {key: field.value for key, field in fields.items() if field.value is not None}


def _field(hint: Any, label: str, value: Any) -> Any:
    # of a setting that may be left out, what it is otherwise
    [hint, *_] = [one for one in get_args(hint) if one is not NoneType] if NoneType in get_args(hint) else [hint]
    plain, *limits = get_args(hint) if hasattr(hint, "__metadata__") else (hint,)
    if plain is bool:
        return ui.checkbox(label, value=value)
    if get_origin(plain) is Literal:
        return ui.select(list(get_args(plain)), value=value, label=label)
    if plain in (int, float):
        low, high = (next((getattr(one, name) for one in limits if isinstance(one, kind)), None)
                     for kind, name in ((Ge, "ge"), (Le, "le")))  # fmt: skip
        return ui.number(label, value=value, min=low, max=high, precision=0 if plain is int else None).classes("pf-number")
    return ui.input(label, value=value)

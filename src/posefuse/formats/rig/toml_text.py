"""Tables of plain values as TOML text; the standard library reads TOML but does not write it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+\Z")


def toml_text(tables: Mapping[tuple[str, ...], Mapping[str, Any]]) -> str:
    """One ``[table.of.parts]`` per entry, keys in order; values are strings, booleans, numbers or nested lists of them."""
    blocks = []
    for name, content in tables.items():
        lines = [f"[{'.'.join(_key(part) for part in name)}]"]
        lines += [f"{_key(key)} = {_value(value)}" for key, value in content.items()]
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks) + "\n"


def _key(name: str) -> str:
    return name if _BARE_KEY.match(name) else _string(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(part) for part in value)}]"
    return repr(value)


def _string(text: str) -> str:
    # a JSON string is a TOML basic string, but for the one control character JSON leaves bare
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")

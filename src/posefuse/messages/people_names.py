"""Names of people as a message and back: a text of JSON, names by person id."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from posefuse.core import MessageError

from .types import message

NAMES_TYPE = "std_msgs/msg/String"


def message_from_names(names: Mapping[int, str]) -> Any:
    """All names that are known."""
    return message(NAMES_TYPE, data=json.dumps({str(person): name for person, name in names.items()}, ensure_ascii=False))


def names_from_message(msg: Any) -> dict[int, str]:
    """As given to `message_from_names`; raises MessageError for anything else."""
    try:
        content = json.loads(msg.data)
        found = {int(person): name for person, name in content.items()}
    except (ValueError, AttributeError, RecursionError):
        raise MessageError("names message: expected a JSON object of names by person id") from None
    if not all(person >= 0 and isinstance(name, str) for person, name in found.items()):
        raise MessageError("names message: expected texts by ids from 0 on")
    return found

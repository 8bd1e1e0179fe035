"""What a page of the studio reads from a message."""

import json
from typing import Any

import numpy as np


def read_message(raw: bytes) -> dict[str, Any]:
    """The head of a message, with its arrays, flat, and its ``file``."""
    at = 4 + int.from_bytes(raw[:4], "little")
    head = json.loads(raw[4:at])
    for name, count in head["arrays"].items():
        head[name] = np.frombuffer(raw, "<f4", count, at)
        at += 4 * count
    return {**head, "file": raw[at:]}

"""Waiting for work that ends by itself, as long as it makes progress."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

_LOOK_S = 0.05


def wait_while_working(progress: Callable[[], Any], patience_s: float, tell: Callable[[], None] = lambda: None) -> bool:
    """Wait until `progress()` is empty; False where it has stayed the same for `patience_s` instead.

    `tell` is called several times a second.
    """
    before, since_s = None, time.monotonic()
    while now := progress():
        if now != before:
            before, since_s = now, time.monotonic()
        elif time.monotonic() - since_s > patience_s:
            return False
        tell()
        time.sleep(_LOOK_S)
    return True

"""What RealSense and OAK cameras have in common: found by serial number, asked for a size, timed by their own clock."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

from posefuse.core import DependencyError, SourceError
from posefuse.core.errors import choices

ANY = "any"


def vendor_module(name: str, extra: str) -> Any:
    """The maker's library; raises DependencyError that says how to get it, or what it lacks itself."""
    try:
        return import_module(name)
    except ImportError as error:
        raise DependencyError(f"{name}: not usable ({error}); install it with: pip install 'posefuse[{extra}]'") from None


def wanted_size(where: str, size: str) -> tuple[int, int, int]:
    """(width, height, rate) of ``WIDTHxHEIGHT[@RATE]``, 30 Hz where no rate is given."""
    match = re.fullmatch(r"(\d+)x(\d+)(?:@(\d+))?", size)
    if not match:
        raise SourceError(f"{where}: size: expected WIDTHxHEIGHT or WIDTHxHEIGHT@RATE, got {size!r}")
    return int(match[1]), int(match[2]), int(match[3] or 30)


def chosen(where: str, wanted: str, there: list[str]) -> str:
    """The serial number to open; raises SourceError that says which are there."""
    if not there:
        raise SourceError(f"{where}: no such camera is connected")
    if wanted in ("", ANY):
        return there[0]
    if wanted not in there:
        raise SourceError(f"{where}: not connected; there are: {choices(sorted(there))}")
    return wanted

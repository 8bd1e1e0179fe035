"""Packages that only an extra of posefuse installs."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from posefuse.core import DependencyError


def package_of_extra(name: str, extra: str) -> ModuleType:
    """Import a package; raises DependencyError with the command that installs the extra."""
    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise DependencyError(f"{package}: not usable ({error}); install it with: pip install 'posefuse[{extra}]'") from None

"""Packages that only an extra of posefuse installs: those of others, and its own (`posefuse_ros`, `posefuse_sim`)."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from .errors import DependencyError

# extras that are packages of this repository
OWN = ("ros", "sim", "studio", "teleop")


def package_of_extra(name: str, extra: str) -> ModuleType:
    """Import a module; raises DependencyError with the command that installs the extra."""
    try:
        return import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise DependencyError(f"{package}: not usable ({error}); {install_words(extra)}") from None


def install_words(extra: str) -> str:
    """How an extra is installed; those of posefuse's own packages in a checkout, too."""
    own = f" (in a checkout: pip install ./packages/posefuse-{extra})" if extra in OWN else ""
    return f"install it with: pip install 'posefuse[{extra}]'{own}"

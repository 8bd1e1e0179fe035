"""Packages that only an extra of posefuse installs (those of others, and its own, such as `posefuse_ros`), and names of a package
that are imported only when they are first used, so that importing the package stays light.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from .errors import DependencyError

# extras that are packages of this repository
OWN = ("ros", "sim", "studio", "teleop")


def package_of_extra(name: str, extra: str) -> ModuleType:
    """Import a module; raises DependencyError with the command that installs the extra."""
    try:
        return import_module(name)
    # a package may lack a native library, which it reports in its own way
    except (ImportError, OSError, RuntimeError) as error:
        package, why = name.partition(".")[0], str(error).partition("\n")[0] or type(error).__name__
        raise DependencyError(f"{package}: not usable ({why}); {install_words(extra)}") from None


def install_words(extra: str) -> str:
    """How an extra is installed; those of posefuse's own packages in a checkout, too."""
    own = f" (in a checkout: pip install ./packages/posefuse-{extra})" if extra in OWN else ""
    return f"install it with: pip install 'posefuse[{extra}]'{own}"


def lazy_names(package: str, file: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose ``__init__`` imports its names in ``if TYPE_CHECKING:`` only.

    A name of another package of posefuse (``posefuse_sim``) raises DependencyError with its extra where that is missing.

    Args:
        package: its ``__name__``. file: its ``__file__``, in which the imports are found.
    """

    @cache
    def homes() -> dict[str, str]:
        blocks = [node for node in ast.parse(Path(file).read_text(encoding="utf-8")).body if isinstance(node, ast.If)]
        imports = [line for block in blocks for line in block.body if isinstance(line, ast.ImportFrom)]
        modules = {line: f"{package}.{line.module}" if line.level else str(line.module) for line in imports}
        return {alias.name: module for line, module in modules.items() for alias in line.names}

    def get(name: str) -> Any:
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes()[name]
        extra = home.partition(".")[0].removeprefix("posefuse").removeprefix("_")
        value = getattr(package_of_extra(home, extra) if extra else import_module(home), name)
        setattr(sys.modules[package], name, value)
        return value

    return get

"""`posefuse plugins`: which cameras, 2D estimators and outputs are there."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from typing import Any

from posefuse.cli.terminal import Terminal
from posefuse.foundation.plugins import GROUPS, list_plugins, option_names

SUMMARY = "list the cameras, 2D estimators and outputs that can be used, ours and others'"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """No options."""


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """List every plug-in of every kind; a broken one with its reason."""
    plugins = [plugin for kind in GROUPS for plugin in list_plugins(kind)]
    rows = [(p.kind, p.name, p.package, p.reason or ", ".join(option_names(p)) or "-") for p in plugins]
    terminal.table("Plug-ins", ("kind", "name", "package", "options, or why it cannot be used"), rows)
    return {
        "plugins": [
            {"kind": p.kind, "name": p.name, "package": p.package, "options": option_names(p), "reason": p.reason or None}
            for p in plugins
        ]
    }

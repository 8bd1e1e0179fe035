"""`posefuse plugins`: which cameras, detectors and outputs can be used."""

from __future__ import annotations

from posefuse.cli.options.shared import Figures, Shown


def plugins(*, terminal: Shown) -> Figures:
    """List the cameras, detectors and outputs that can be used, bundled and from other packages.

    A plug-in that cannot be used is listed with the reason.
    """
    from posefuse.foundation.plugins import GROUPS, list_plugins, option_names

    found = [plugin for kind in GROUPS for plugin in list_plugins(kind)]
    rows = [(p.kind, p.name, p.package, p.reason or ", ".join(option_names(p)) or "-") for p in found]
    terminal.table("Plug-ins", ("kind", "name", "package", "options, or why it cannot be used"), rows)
    return {
        "plugins": [
            {"kind": p.kind, "name": p.name, "package": p.package, "options": option_names(p), "reason": p.reason or None}
            for p in found
        ]
    }

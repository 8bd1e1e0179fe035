"""`posefuse doctor`: what works on this machine, and what to install for the rest."""

from __future__ import annotations

from posefuse.cli.options.shared import Figures, Shown


def doctor(*, terminal: Shown) -> Figures:
    """Check what works on this machine, and list what to install for the rest.

    Needed things that fail are marked MISSING; the command itself succeeds.
    """
    from posefuse.cli.machine import machine_checks

    checks = machine_checks()
    rows = [("ok" if c.ok else "MISSING" if c.needed else "no", c.name, c.found, "" if c.ok else c.cure) for c in checks]
    terminal.table("This machine", ("", "what", "found", "what to do"), rows)
    ready = all(check.ok for check in checks if check.needed)
    terminal.note("Ready: `posefuse track SESSION --out DIR` will work." if ready else "Not ready: see the lines marked MISSING.")
    return {
        "ready": ready,
        "checks": [{"name": c.name, "ok": c.ok, "needed": c.needed, "found": c.found, "cure": c.cure} for c in checks],
    }

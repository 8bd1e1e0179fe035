"""`posefuse doctor`, `models`, `plugins` and `studio`: what this machine has."""

from typing import Annotated

from cyclopts import Parameter

import posefuse as pf

from .options import Figures, Shown, check_used


def doctor(*, terminal: Shown) -> Figures:
    """Check what works on this machine, and list what to install for the rest.

    Needed things that fail are marked MISSING; the command itself succeeds.
    """
    found = pf.doctor()
    terminal.show(found.summary())
    return found.figures


def plugins(*, terminal: Shown) -> Figures:
    """List the cameras, detectors and outputs that can be used, bundled and from other packages.

    A plug-in that cannot be used is listed with the reason.
    """
    found = pf.plugins()
    terminal.show(found.summary())
    return found.figures


def models(
    *names: Annotated[str, Parameter(metavar="MODEL")],
    check: bool = False,
    accept_licence: bool = False,
    terminal: Shown,
) -> Figures:
    """Download the neural networks into the user's cache and verify them.

    Args:
        names: Names of models (default: those that the default settings need).
        check: Only verify what is there; exit code 1 where a network is missing or damaged.
        accept_licence: Accept the terms of the networks named.
    """
    check_used(
        [
            ("--accept-licence", accept_licence, not check, "expected a download, not --check"),
            ("--accept-licence", accept_licence, names, "expected the names of the networks whose terms were read"),
        ]
    )
    with terminal.stages() as progress:
        found = pf.models(names, check=check, accept_licence=accept_licence, progress=progress)
    terminal.show(found.summary())
    return found.figures

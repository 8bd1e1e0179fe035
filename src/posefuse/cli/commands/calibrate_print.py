"""`posefuse calibrate print`."""

from __future__ import annotations

from posefuse.cli.options.calibration import PrintOptions, TargetOptions
from posefuse.cli.options.shared import Figures, Shown


def calibrate_print(*, target: TargetOptions = TargetOptions(), options: PrintOptions, terminal: Shown) -> Figures:
    """Make a PDF of a target at its true size."""
    from posefuse.cli.calibrating.target_steps import print_target

    return print_target(target, options, terminal)

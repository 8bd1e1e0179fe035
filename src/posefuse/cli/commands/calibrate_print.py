"""`posefuse calibrate print`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .calibrate_options import ReplaceOptions, TargetOptions
from .options import Figures, Shown


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PrintOptions(ReplaceOptions):
    """What is printed."""

    out: Annotated[Path, Parameter(metavar="FILE")]
    """PDF to write."""
    cube: bool = False
    """Six markers for a cube."""
    page: Annotated[str, Parameter(metavar="SIZE")] = "a4"
    """Paper: a4, a3, a2, a1, a0 or letter."""


def calibrate_print(*, target: TargetOptions = TargetOptions(), options: PrintOptions, terminal: Shown) -> Figures:
    """Make a PDF of a target at its true size."""
    from posefuse.cli.calibrating.target_steps import print_target

    return print_target(target, options, terminal)

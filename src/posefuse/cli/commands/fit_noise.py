"""`posefuse fit-noise`: how large the errors of your own network are, and where joint centres lie relative to its keypoints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.fit_noise import FitOptions
from posefuse.cli.options.shared import Figures, Shown


def fit_noise(card: Annotated[Path, Parameter(metavar="CARD.toml")], /, *, options: FitOptions, terminal: Shown) -> Figures:
    """Fit noise and joint centres of your own network's model card on simulated people (an hour or more).

    Args:
        card: Model card; see docs/networks.md.
    """
    from posefuse.cli.fitting import fit_card

    return fit_card(card, options, terminal)

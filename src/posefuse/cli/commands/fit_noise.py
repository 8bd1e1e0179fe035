"""`posefuse fit-noise`: how large the errors of your own network are, and where joint centres lie relative to its keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .options import Figures, Shown, count

MOST_SCENES = 100


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """The scenes, and what runs the network."""

    scenes_in: Annotated[Path, Parameter(metavar="DIR")]
    """Folder for the rendered scenes; later fits use them again."""
    scenes: Annotated[int, Parameter(metavar="N"), count(MOST_SCENES)] = 24
    """Scenes for the noise."""
    moving: Annotated[int, Parameter(metavar="N"), count(MOST_SCENES)] = 16
    """Scenes for the joint centres; 16 are all."""
    engine: Literal["openvino", "onnxruntime"] = "openvino"
    """What runs the network."""


def fit_noise(card: Annotated[Path, Parameter(metavar="CARD.toml")], /, *, options: FitOptions, terminal: Shown) -> Figures:
    """Fit noise and joint centres of your own network's model card on simulated people (an hour or more).

    Args:
        card: Model card; see docs/networks.md.
    """
    from posefuse.cli.fitting import fit_card

    return fit_card(card, options, terminal)

"""Options of `posefuse fit-noise`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from .shared import count

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
    """Scenes for the joint centres; at most 16."""
    engine: Literal["openvino", "onnxruntime"] = "openvino"
    """What runs the network."""

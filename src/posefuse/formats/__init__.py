"""Values to and from files, one module per format."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .joint_centres import joint_centres_from_mapping
    from .rig import read_rig
    from .truth import read_truth

__getattr__ = lazy_names(__name__, __file__)

"""One skeleton of constant segment lengths, fitted to 3D points or to the rays of all views, causally or offline."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from posefuse.kinematics.settings import LIVE_BODY, BodySettings, LiveBodyRules

    from .fit import BodyFit, fit_poses, fit_views
    from .live import LiveBody, LiveRays, TrackedPoints
    from .model import FEWEST_SEEN, BodyModel, Length, bodies_from_poses
    from .shape import LengthPrior, with_solved_lengths

__getattr__ = lazy_names(__name__, __file__)

"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Times are seconds since the person's birth. Cameras are rows of (R 9, t 3, centre 3), measurements ideal image-plane points with
`white`, the (2, 2) matrix that turns their errors into sigmas.
"""

from .own_motion import anticipate, learn, missing_per_second
from .pose import pose, where
from .rays import agreement, measure
from .sides import exchange_groups
from .state import GROUPS, born, state_size
from .step import FIGURES, step
from .updates import begin_again

__all__ = [
    "FIGURES",
    "GROUPS",
    "agreement",
    "anticipate",
    "begin_again",
    "born",
    "exchange_groups",
    "learn",
    "measure",
    "missing_per_second",
    "pose",
    "state_size",
    "step",
    "where",
]

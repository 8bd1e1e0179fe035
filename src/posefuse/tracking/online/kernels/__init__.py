"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Times are seconds since the person's birth. Cameras are rows of (R 9, t 3, centre 3), measurements ideal image-plane points with
`white`, the (2, 2) matrix that turns their errors into sigmas.
"""

from .pose import pose, where
from .rays import agreement, measure
from .state import born, state_size
from .step import FIGURES, step
from .updates import begin_again

__all__ = ["FIGURES", "agreement", "begin_again", "born", "measure", "pose", "state_size", "step", "where"]

"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Times are seconds since the person's birth. Arrays that belong together are one named tuple: `SessionArrays`, `KeypointRays` of
one view, and `StateParts`, the parts of the flat array that a person is kept as.
"""

from .evidence import rays_of_person
from .own_motion import CorrectionLimits, Prediction, Regression, WatchedKeypoints, anticipate, correct, learn
from .pose import PoseRow, pose, where
from .rays import measure, person_agreement
from .session import KeypointRays, Rules, SessionArrays
from .sides import exchange_groups
from .state import GROUPS, born, state_size
from .step import ViewFigures, step
from .updates import begin_again

__all__ = [
    "GROUPS",
    "CorrectionLimits",
    "KeypointRays",
    "PoseRow",
    "Prediction",
    "Regression",
    "Rules",
    "SessionArrays",
    "ViewFigures",
    "WatchedKeypoints",
    "anticipate",
    "begin_again",
    "born",
    "correct",
    "exchange_groups",
    "learn",
    "measure",
    "person_agreement",
    "pose",
    "rays_of_person",
    "state_size",
    "step",
    "where",
]

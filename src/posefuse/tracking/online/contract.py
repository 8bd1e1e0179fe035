"""What a live tracker offers: the only thing in a live session that remembers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from posefuse.core import Detections2D, Pose3D, Views
from posefuse.core.arrays import Array

from .person import Evidence

# one Detections2D per camera of the rig, in its order, of about one moment; and the pose before, or None -> the people in them
Solve = Callable[[Sequence[Detections2D], Pose3D | None], Pose3D]
# the views of one moment that are known to show the same people -> these people, in the same order
Fuse = Callable[[Views], Pose3D]


@dataclass(frozen=True, kw_only=True)
class CameraStatistics:
    """Statistics of one camera's views. Shares and rms run over about the last hundred views.

    Attributes:
        used: views that found a tracked person. age_s: from its newest view to the newest time the tracker knows; NaN
            before the first.
        innovation_sigmas: rms of its keypoints' normalised innovations (1 for a healthy camera); NaN before the first.
        gated_share: share of its keypoints that were too far off to be used.
        flipped_share: share of its views with left and right exchanged somewhere.
        unclaimed: views that showed no person who is tracked. late, ahead: views refused as older than the buffer, or from
            the future (a wrong clock). repeated: views with a time already received. crowded: views beyond the allowed rate.
    """

    used: int = 0
    age_s: float = float("nan")
    innovation_sigmas: float = float("nan")
    gated_share: float = 0.0
    flipped_share: float = 0.0
    unclaimed: int = 0
    late: int = 0
    ahead: int = 0
    repeated: int = 0
    crowded: int = 0


class Tracker(Protocol):
    """Follows people through single views. No clock inside: the same calls give the same answers."""

    def add(self, detections: Detections2D) -> Array:
        """Everybody one camera saw at its own time; late or out of order within the lag buffer, people in any order.

        Returns:
            (P,) the track that each of them was taken for; -1: none, or this tracker does not know.

        Raises:
            ShapeError: a camera the rig does not have, or another skeleton. Wrong times are no error: see `health`.
        """
        ...

    def at(self, t_ns: int) -> Pose3D:
        """Everybody who is tracked, at t_ns; NaN where lost. See `LiveMotion.measured_s` for kind FUSED and PREDICTED.

        With several people, person_id numbers tracks: a person who was lost for long gets another number.

        n_views counts the cameras, and reproj_px is over the views, of the last `LiveMotion.measured_s`.
        """
        ...

    def looked_for(self, t_ns: int) -> Pose3D:
        """Every person that the views should look for at t_ns, including those without an identity so far."""
        ...

    def check(self) -> None:
        """Do what takes longer and can wait: for callers who have time now, just after an output.

        Work that is due and was not done here is done by the next `add`, and delays it by milliseconds.
        """
        ...

    def evidence(self, t_ns: int) -> Mapping[int, Evidence]:
        """By person_id as in `at`, what the pose at t_ns rests on; empty where this tracker keeps nothing."""
        ...

    @property
    def health(self) -> Mapping[str, CameraStatistics]:
        """By camera name, every camera of the rig."""
        ...

"""Live output ``lsl``: keypoints and joint angles as streams of the Lab Streaming Layer (extra `lsl`)."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from posefuse.core import JointAngles, LiveMessage, LiveOutput, LivePose, LiveStart, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.extras import package_of_extra
from posefuse.core.joint_angles import angle_labels
from posefuse.core.poses import point_sigma_m
from posefuse.foundation.settings import settings

_S = 1_000_000_000
_CLOCK_READINGS = 9
# what a receiver that falls behind may still get, in hundreds of samples
_BUFFERED = 10
KEYPOINTS, ANGLES = "keypoints", "joint angles"


@settings
class LslConfig:
    """Two LSL streams of one person: ``NAME keypoints`` (x, y, z, sigma of each in m) and ``NAME joint angles`` (rad).

    What is missing is NaN. The last channel is the person's id, NaN while there is no person.

    Attributes:
        stream: NAME.
        person: id of the person; None: the selected person is kept while followed, then the one with the lowest id is selected.
    """

    stream: str = "posefuse"
    person: int | None = None
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose,)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened; raises DependencyError where pylsl or its native library is missing."""
        _pylsl()
        return LslOutput(self)


class LslOutput:
    """Pushes one sample per pose and stream; the streams are announced with the first pose, which names their channels."""

    name = "lsl"

    def __init__(self, config: LslConfig) -> None:
        self._config, self.where = config, f"LSL streams {config.stream!r}"
        self._start: LiveStart | None = None
        self._lsl_from_session_ns = 0
        self._person: int | None = None
        self._keypoints: Any = None
        self._angles: Any = None

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._start, self._lsl_from_session_ns = message, lsl_clock_offset_ns() - message.clock_offset_ns
            case LivePose(pose=pose, joints=joints):
                self._push(pose, joints)

    def close(self) -> None:
        """Withdraw the streams."""
        self._keypoints = self._angles = None

    def _push(self, pose: Pose3D, joints: JointAngles | None) -> None:
        t_s = (pose.t_ns + self._lsl_from_session_ns) / _S
        self._person = chosen_person(pose.person_id.tolist(), self._person, self._config.person)
        if self._keypoints is None:
            self._keypoints = self._outlet(KEYPOINTS, *keypoint_channels(pose.skeleton.keypoints), pose.skeleton.name)
        self._keypoints.push_sample(keypoint_sample(pose, self._person), t_s)
        if joints is not None:
            if self._angles is None:
                self._angles = self._outlet(ANGLES, *angle_channels(joints), pose.skeleton.name)
            self._angles.push_sample(angle_sample(joints, self._person), t_s)

    def _outlet(self, what: str, labels: list[str], units: list[str], skeleton: str) -> Any:
        lsl, start = _pylsl(), self._start
        assert start is not None
        name = f"{self._config.stream} {what}"
        # a receiver finds the stream of a session that was started again on the same machine by it
        source_id = f"{name} {os.uname().nodename if hasattr(os, 'uname') else 'host'} {start.rig.id}"
        # at a regular rate XDF readers replace the times by a straight line, which output ticks that were skipped would bend
        info = lsl.StreamInfo(name, "MoCap", len(labels), lsl.IRREGULAR_RATE, lsl.cf_double64, source_id)
        info.set_channel_labels(labels)
        info.set_channel_units(units)
        info.set_channel_types("MoCap")
        about = info.desc().append_child("acquisition")
        facts = {"software": "posefuse", "skeleton": skeleton, "rig_id": start.rig.id, "rate_hz": f"{start.rate_hz:g}"}
        for key, value in {**facts, "axes": "world: right-handed, z up", "missing": "NaN"}.items():
            about.append_child_value(key, value)
        return lsl.StreamOutlet(info, max_buffered=_BUFFERED)


def chosen_person(there: Sequence[int], before: int | None, wanted: int | None) -> int | None:
    """Whose sample comes next among the ids that are `there`; None when there is no such person."""
    if wanted is not None:
        return wanted if wanted in there else None
    return before if before in there else min(there, default=None)


def keypoint_channels(keypoints: Sequence[str]) -> tuple[list[str], list[str]]:
    """(labels, units) of the stream of keypoints."""
    labels = [f"{name}_{part}" for name in keypoints for part in ("x", "y", "z", "sigma")]
    return [*labels, "person_id"], [*["meters"] * len(labels), "none"]


def angle_channels(joints: JointAngles) -> tuple[list[str], list[str]]:
    """(labels, units) of the stream of joint angles: each angle, then its standard deviation."""
    labels = [label for name in angle_labels(joints, "/") for label in (name, f"{name}_sigma")]
    return [*labels, "person_id"], [*["radians"] * len(labels), "none"]


def keypoint_sample(pose: Pose3D, person: int | None) -> Array:
    """(4 K + 1,): x, y, z, sigma over the three axes of each keypoint in m, and the person's id."""
    values = np.concatenate([pose.xyz_world, point_sigma_m(pose.cov_world)[..., None]], axis=-1)
    return _sample(values, pose.person_id, person)


def angle_sample(joints: JointAngles, person: int | None) -> Array:
    """(6 J + 1,): every angle and its standard deviation in rad, and the person's id."""
    return _sample(np.stack([joints.angle_rad[-1], joints.sigma_rad[-1]], axis=-1), joints.person_id, person)


def _sample(values: Array, ids: Array, person: int | None) -> Array:
    """The values (N, ...) of one of the people (N,), and the person's id; NaN where the person is not there."""
    sample = np.full(math.prod(values.shape[1:]) + 1, np.nan)
    for n in np.flatnonzero(ids == person):
        sample[:-1], sample[-1] = values[n].ravel(), person
    return sample


def lsl_clock_offset_ns() -> int:
    """LSL's local clock minus `time.monotonic_ns()`, from the reading that was the least interrupted."""
    lsl = _pylsl()
    readings: list[tuple[int, int]] = []
    for _ in range(_CLOCK_READINGS):
        before, theirs, after = time.monotonic_ns(), lsl.local_clock(), time.monotonic_ns()
        readings.append((after - before, round(theirs * _S) - (before + after) // 2))
    return min(readings)[1]


def _pylsl() -> Any:
    return package_of_extra("pylsl", "lsl")

"""From what the networks of the cameras mark to joint centres, live as in recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from posefuse.core import JointCentres, LiveJointCentres, Pose3D
from posefuse.messages.joint_centre_messages import joint_centres_from_message, message_from_joint_centres
from posefuse.tracking import LearntLengths, at_joint_centres

from .messages import Centres


class Centring:
    """Moves poses to joint centres, and learns on the way how long people's segments are.

    A pose is made of all cameras' views; should they come from networks with different tables, the table of the rig's first
    camera that has one counts.
    """

    def __init__(self, cameras: Sequence[str], wanted: bool) -> None:
        self._tables: dict[str, JointCentres | None] = dict.fromkeys(cameras)
        self._wanted = wanted
        self._lengths: LearntLengths | None = None

    def learn(self, centres: Centres) -> None:
        """What is known of some cameras, from now on."""
        self._tables.update({name: centres.table for name in centres.cameras if name in self._tables})
        table = next((table for table in self._tables.values() if table is not None), None)
        if table is None:
            self._lengths = None
        elif self._lengths is None or self._lengths.table != table:
            self._lengths = LearntLengths(table)

    @property
    def made_by(self) -> dict[str, str]:
        """Which table each camera's network has; only those that have one, and nothing where it is not wanted."""
        return {name: table.made_by for name, table in self._tables.items() if table is not None and self._wanted}

    @property
    def fitted(self) -> bool:
        """Whether poses are moved by a table that was fitted to a detector."""
        return self._wanted and self._lengths is not None

    def moved(self, pose: Pose3D) -> Pose3D:
        """The next pose at joint centres, where they are wanted and known; poses come in the order of their times."""
        if self._lengths is None or not self._wanted:
            return pose
        lengths = self._lengths.step(pose)
        return at_joint_centres(pose, self._lengths.table, lengths) if len(lengths) else pose


def live_centres(centres: Centres, t_ns: int) -> LiveJointCentres:
    """For outputs."""
    return LiveJointCentres(t_ns=t_ns, cameras=centres.cameras, table=centres.table)


def message_from_centres(centres: Centres, t_ns: int) -> Any:
    """For the network."""
    return message_from_joint_centres(centres.cameras, centres.table, t_ns)


def centres_from_message(msg: Any) -> Centres:
    """What `message_from_centres` made; raises MessageError for what a stranger may send."""
    return Centres(*joint_centres_from_message(msg))

"""From what the networks of the cameras mark to joint centres, live as in recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from posefuse.core import Pose3D
from posefuse.track import JointCentres, to_joint_centres
from posefuse.track.joint_centres import check_joint_centres
from posefuse.wire.messages import joint_centres_from_message, message_from_joint_centres

from .messages import Centres


class Centring:
    """Moves poses to joint centres.

    A pose is made of all cameras' views; should they come from networks with different tables, the table of the rig's first
    camera that has one counts.
    """

    def __init__(self, cameras: Sequence[str], wanted: bool) -> None:
        self._tables: dict[str, JointCentres | None] = dict.fromkeys(cameras)
        self._wanted = wanted

    def learn(self, told: Centres) -> None:
        """What is known of some cameras, from now on."""
        self._tables.update({name: told.table for name in told.cameras if name in self._tables})

    @property
    def made_by(self) -> dict[str, str]:
        """Which table each camera's network has; only those that have one, and nothing where it is not wanted."""
        return {name: table.made_by for name, table in self._tables.items() if table is not None and self._wanted}

    def moved(self, pose: Pose3D) -> Pose3D:
        """The same pose at joint centres, where they are wanted and known."""
        table = next((table for table in self._tables.values() if table is not None), None)
        return pose if table is None or not self._wanted else to_joint_centres(pose, table)


def message_from_centres(told: Centres, t_ns: int) -> Any:
    """For the network and recordings: the offsets alone, as one pose does not tell the lengths of its segments."""
    table = told.table
    return message_from_joint_centres(told.cameras, table.made_by if table else "", table.offsets if table else {}, t_ns)


def centres_from_message(msg: Any) -> Centres:
    """What `message_from_centres` made; raises MessageError or ConfigError for what a stranger may send."""
    cameras, made_by, offsets = joint_centres_from_message(msg)
    return Centres(cameras, check_joint_centres(JointCentres(made_by=made_by, offsets=offsets), made_by) if offsets else None)

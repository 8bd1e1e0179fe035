"""Tables of joint centres as messages and back: what is added to the keypoints in some cameras' views, in 3D."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from posefuse.core import ConfigError, JointCentres, MessageError
from posefuse.core.arrays import Array

from .messages import header
from .types import message

JOINT_CENTRES_TYPE = "posefuse_msgs/msg/JointCentres"
# of each list of names: a table of all joints and segments there are needs a third
MAX_ENTRIES = 512
MAX_OFFSET_M, MAX_LENGTH_M, MAX_SLOPE = 0.5, 3.0, 1.0
_WHERE = "JointCentres message"
# what goes over the network where no offsets are known
_NO_TABLE = JointCentres(made_by="", offsets={})


def message_from_joint_centres(cameras: Sequence[str], table: JointCentres | None, t_ns: int) -> Any:
    """`posefuse_msgs/JointCentres`, stamped `t_ns`; without offsets where there is no table."""
    table = table or _NO_TABLE
    offsets, slopes = list(_leaves(table.offsets)), list(_leaves(table.by_length))
    return message(
        JOINT_CENTRES_TYPE,
        header=header(t_ns, ""),
        cameras=list(cameras),
        made_by=table.made_by,
        joint=[joint for (joint, _), _ in offsets],
        direction=[direction for (_, direction), _ in offsets],
        offset_m=np.array([metres for _, metres in offsets], np.float64),
        segment=list(table.lengths),
        length_m=np.array(list(table.lengths.values()), np.float64),
        slope_joint=[joint for (joint, _, _), _ in slopes],
        slope_direction=[direction for (_, direction, _), _ in slopes],
        slope_segment=[segment for (_, _, segment), _ in slopes],
        slope=np.array([slope for _, slope in slopes], np.float64),
    )


def joint_centres_from_message(msg: Any) -> tuple[tuple[str, ...], JointCentres | None]:
    """Cameras and table as given to `message_from_joint_centres`; raises MessageError for anything that does not fit."""
    if not 0 < len(msg.cameras) <= MAX_ENTRIES:
        raise MessageError(f"{_WHERE}: expected 1 to {MAX_ENTRIES} cameras, got {len(msg.cameras)}")
    offsets = _entries("offset_m", msg.offset_m, (msg.joint, msg.direction), lambda m: np.abs(m) <= MAX_OFFSET_M)
    lengths = _entries("length_m", msg.length_m, (msg.segment,), lambda m: (m > 0) & (m <= MAX_LENGTH_M))
    named = (msg.slope_joint, msg.slope_direction, msg.slope_segment)
    slopes = _entries("slope", msg.slope, named, lambda m: np.abs(m) <= MAX_SLOPE)
    table: dict[str, Any] = {"made_by": msg.made_by, "offsets": {}, "lengths": {}, "by_length": {}}
    for (joint, direction), metres in offsets.items():
        table["offsets"].setdefault(joint, {})[direction] = metres
    for (segment,), metres in lengths.items():
        table["lengths"][segment] = metres
    for (joint, direction, segment), slope in slopes.items():
        table["by_length"].setdefault(joint, {}).setdefault(direction, {})[segment] = slope
    try:
        return tuple(msg.cameras), JointCentres(**table) if table["offsets"] else None
    except ConfigError as error:
        raise MessageError(f"{_WHERE}: {error}") from None


def _leaves(tree: Mapping[str, Any]) -> Iterator[tuple[tuple[str, ...], float]]:
    """(names on the way, number) of every number in nested mappings."""
    for name, inside in tree.items():
        if isinstance(inside, Mapping):
            yield from (((name, *names), number) for names, number in _leaves(inside))
        else:
            yield (name,), inside


def _entries(
    field: str, numbers: Any, named: Sequence[Sequence[str]], fits: Callable[[Array], Array]
) -> dict[tuple[str, ...], float]:
    """Each number by its names; raises MessageError unless lists are as long as each other, short, and every number fits."""
    values = np.asarray(numbers, np.float64)
    counts = {values.size, *map(len, named)}
    if len(counts) > 1 or values.size > MAX_ENTRIES:
        raise MessageError(f"{_WHERE}: {field}: expected as many names as numbers, {MAX_ENTRIES} at most, got {sorted(counts)}")
    wrong = values[~fits(values)]
    if len(wrong):
        raise MessageError(f"{_WHERE}: {field}: {wrong[0]:g} cannot be")
    entries = dict(zip(zip(*named, strict=True), values.tolist(), strict=True))
    if len(entries) < values.size:
        raise MessageError(f"{_WHERE}: {field}: expected each name once, got one again")
    return entries

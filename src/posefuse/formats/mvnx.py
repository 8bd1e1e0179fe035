"""MVNX: what Xsens suits export. The origins of segments are joint centres; metres, Z up."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from posefuse.core import InputError
from posefuse.core.errors import choices

from .named_points import NamedPoints

# the segment of an MVNX file whose origin is this joint
_JOINTS = {
    "pelvis": "mid_hip", "neck": "neck", "head": "head",
    **{f"{side}{segment}": f"{side}_{joint}" for side in ("left", "right") for segment, joint in (
        ("upperarm", "shoulder"), ("forearm", "elbow"), ("hand", "wrist"),
        ("upperleg", "hip"), ("lowerleg", "knee"), ("foot", "ankle"), ("toe", "big_toe"),
    )},
}  # fmt: skip


def read_mvnx(path: Path) -> NamedPoints:
    """Read the joint centres of a file; raises InputError for one that is not MVNX or has none of the segments."""
    labels: list[str] = []
    times, positions = [], []
    try:
        for _event, element in ET.iterparse(path):
            tag = element.tag.rpartition("}")[2]
            if tag == "segment" and element.get("label"):
                labels.append(str(element.get("label")))
            elif tag == "frame":
                text = next((child.text for child in element if child.tag.rpartition("}")[2] == "position"), None)
                if element.get("type") == "normal" and text:
                    times.append(float(element.get("time", "nan")) / 1000)
                    positions.append([float(number) for number in text.split()])
                element.clear()
    except (ET.ParseError, ValueError, OSError, RecursionError) as error:
        raise InputError(f"{path}: not an MVNX file ({' '.join(str(error).split())})") from None
    if not positions or {len(row) for row in positions} != {3 * len(labels)}:
        raise InputError(f"{path}: expected frames with a position of each of {len(labels)} segments")
    known = [(i, _JOINTS[label.lower()]) for i, label in enumerate(labels) if label.lower() in _JOINTS]
    if not known:
        raise InputError(f"{path}: expected segments such as {choices(list(_JOINTS)[:4])}, got {choices(labels[:8])}")
    xyz = np.array(positions).reshape(len(times), -1, 3)[:, [i for i, _name in known]]
    return NamedPoints(names=tuple(name for _i, name in known), t_s=np.array(times), xyz_world=xyz)

"""ROS message types as the IDL classes Cyclone DDS wants for a topic.

Only the type's name and layout are taken from here; bytes are written and read by `rosbags`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from .types import dds_type_name, ros2_types

_BASIC = {
    "bool": "bool",
    "byte": "byte",
    "char": "uint8",
    "float32": "float32",
    "float64": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}


@cache
def idl_class(type_name: str) -> Any:
    """A final, keyless IDL struct named as ROS 2 names `type_name` on the wire."""
    from cyclonedds.idl import annotations, make_idl_struct

    fields = {name: _idl_type(desc) for name, desc in ros2_types().fielddefs[type_name][1]}
    dds_name = dds_type_name(type_name)
    made = make_idl_struct(dds_name.rsplit("::", 1)[1], dds_name.replace("::", "."), fields)
    return annotations.final(made)


def _idl_type(desc: Any) -> Any:
    import cyclonedds.idl.types
    from rosbags.interfaces import Nodetype

    types: Any = cyclonedds.idl.types  # made while they are subscripted
    kind, detail = desc
    if kind == Nodetype.NAME:
        return idl_class(detail)
    if kind == Nodetype.BASE:
        name, bound = detail
        if name == "string":
            return types.bounded_str[bound] if bound else str
        return getattr(types, _BASIC[name]) if name != "bool" else bool
    inner, length = detail
    element = _idl_type(inner)
    if kind == Nodetype.ARRAY:
        return types.array[element, length]
    return types.sequence[element, length] if length else types.sequence[element]

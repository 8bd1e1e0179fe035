"""ROS message types without ROS: the standard ones, `hri_msgs` of REP-155, and our own `posefuse_msgs`.

Their IDL classes for Cyclone DDS, and bytes from strangers to their values: what does not fit is refused and counted.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from posefuse.core import MessageError, PosefuseError
from posefuse.core.extras import package_of_extra

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

DEFINITIONS = Path(__file__).parent / "msg"
# longest list a stranger may announce in a message; ours stay far below it, images are the largest
MAX_LIST = 64 * 2**20
T = TypeVar("T")


def optional_module(name: str) -> ModuleType:
    """Import a package of the extra ``ros``; raises DependencyError with the command to install it."""
    return package_of_extra(name, "ros")


@cache
def ros2_types() -> Typestore:
    """ROS 2 (Jazzy) types with ours added. CDR bytes are the same in every ROS 2."""
    store = _store("ROS2_JAZZY", ours())
    # rosidl makes uint8 of the `char` of a .msg file, and hashes that; rosbags hashes `char`
    fielddefs: Any = store.fielddefs
    for name, (constants, fields) in list(fielddefs.items()):
        fielddefs[name] = constants, [(field, _with_uint8(desc)) for field, desc in fields]
    return store


@cache
def ros1_types() -> Typestore:
    """ROS 1 (Noetic) types with ours added."""
    texts = ours() | {"tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms"}
    return _store("ROS1_NOETIC", texts)


def ours() -> dict[str, str]:
    """Text of each .msg file of this package by type name, e.g. ``posefuse_msgs/msg/Pose3D``."""
    return {
        f"{path.parent.name}/msg/{path.stem}": path.read_text(encoding="utf-8") for path in sorted(DEFINITIONS.glob("*/*.msg"))
    }


def _with_uint8(desc: Any) -> Any:
    """A field's type with `char` replaced, at any depth."""
    kind, detail = desc
    if detail == ("char", 0):
        return kind, ("uint8", 0)
    return (kind, (_with_uint8(detail[0]), detail[1])) if isinstance(detail[0], tuple) else desc


def _store(name: str, texts: Mapping[str, str]) -> Typestore:
    typesys = optional_module("rosbags.typesys")
    base = optional_module(f"rosbags.typesys.stores.{name.lower()}")
    from rosbags.typesys.store import Typestore

    store = Typestore(base, max_sequence_length=MAX_LIST)
    found: dict[str, Any] = {}
    for type_name, text in texts.items():
        found.update(typesys.get_types_from_msg(text, type_name))
    store.register(found)
    return store


def message(type_name: str, /, **fields: Any) -> Any:
    """A ROS 2 message of `type_name` (``pkg/msg/Type``); raises TypeError for a field that is missing or unknown."""
    return ros2_types().types[type_name](**fields)


def sparse_message(type_name: str, /, **fields: Any) -> Any:
    """As `message`; what is not given is zero or empty, as ROS makes messages, and shared by all that leave it out."""
    return replace(_empty_message(type_name), **fields)


@cache
def _empty_message(type_name: str) -> Any:
    from rosbags.convert.converter import default_message

    return default_message(ros2_types(), type_name)


def encode(msg: Any) -> bytes:
    """CDR bytes (little endian, with encapsulation header) of a ROS 2 message; padded to 4 bytes as DDS wants."""
    raw = bytes(ros2_types().serialize_cdr(msg, msg.__msgtype__, little_endian=True))
    return raw + bytes(-len(raw) % 4)


def type_hash(type_name: str) -> str:
    """RIHS01 hash (REP-2016), which ROS 2 tools compare between peers."""
    return str(ros2_types().hash_rihs01(type_name))


def definition(type_name: str) -> str:
    """Full text of a type with all it is made of, as bags carry it."""
    return str(ros2_types().generate_msgdef(type_name, ros_version=2)[0])


@cache
def idl_class(type_name: str) -> Any:
    """A final, keyless IDL struct named as ROS 2 names `type_name` on the wire: ``pkg::msg::dds_::Type_``."""
    from cyclonedds.idl import annotations, make_idl_struct

    fields = {name: _idl_type(desc) for name, desc in ros2_types().fielddefs[type_name][1]}
    package, kind, name = type_name.split("/")
    return annotations.final(make_idl_struct(f"{name}_", f"{package}.{kind}.dds_.{name}_", fields))


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
        return getattr(types, name) if name != "bool" else bool
    inner, length = detail
    element = _idl_type(inner)
    if kind == Nodetype.ARRAY:
        return types.array[element, length]
    return types.sequence[element, length] if length else types.sequence[element]


def decode(raw: bytes, type_name: str, max_bytes: int) -> Any:
    """The message in CDR bytes; raises MessageError when malformed or longer than `max_bytes`."""
    from rosbags.serde import SerdeError

    if len(raw) > max_bytes:
        raise MessageError(f"{type_name}: expected at most {max_bytes} bytes, got {len(raw)}")
    try:
        return ros2_types().deserialize_cdr(raw, type_name)
    except (SerdeError, IndexError, ValueError, OverflowError, MemoryError, struct.error) as error:
        raise MessageError(f"{type_name}: malformed message ({error})") from None


@dataclass
class Counts:
    """What came in over one topic.

    Attributes:
        accepted: values handed on. refused: messages that did not fit.
        last_refusal: why, of the newest one refused; empty when none was.
    """

    accepted: int = 0
    refused: int = 0
    last_refusal: str = ""


@dataclass
class Intake(Generic[T]):
    """Turns the bytes of one topic into values and keeps count.

    Attributes:
        type_name: ROS type expected.
        value_from_message: e.g. `messages.detections_from_message`; may raise any PosefuseError.
        max_bytes: longer messages are refused unread.
    """

    type_name: str
    value_from_message: Callable[[Any], T]
    max_bytes: int = 2**20
    counts: Counts = field(default_factory=Counts)

    def take(self, raw: bytes) -> T | None:
        """The value, or None when it was refused."""
        try:
            value = self.value_from_message(decode(raw, self.type_name, self.max_bytes))
        except PosefuseError as error:
            self.counts.refused += 1
            self.counts.last_refusal = str(error)
            return None
        self.counts.accepted += 1
        return value

"""Type hashes (RIHS01, REP-2016) computed again from the definitions, without the library that posefuse uses for it."""

import hashlib
import json

import pytest

from posefuse_ros import topics
from posefuse_ros.dds import GRAPH
from posefuse_ros.types import ros2_types, type_hash

# type_description_interfaces/msg/FieldType; rosidl makes uint8 of the `char` of a .msg file
IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9, "float32": 10,
    "float64": 11, "char": 3, "bool": 15, "byte": 16,
}  # fmt: skip
STRING, BOUNDED_STRING, NESTED = 17, 21, 1
ARRAY, BOUNDED_SEQUENCE, SEQUENCE = 48, 96, 144


def field_type(kind, detail, offset=0, capacity=0):
    name = str(getattr(kind, "name", kind)).upper()
    found = {"type_id": 0, "capacity": capacity, "string_capacity": 0, "nested_type_name": ""}
    if name == "BASE":
        base, bound = detail
        if base == "string":
            found |= {"type_id": (BOUNDED_STRING if bound else STRING) + offset, "string_capacity": bound}
        else:
            found["type_id"] = IDS[base] + offset
        return found
    if name == "NAME":
        return found | {"type_id": NESTED + offset, "nested_type_name": detail}
    inner, length = detail
    if name == "ARRAY":
        return field_type(*inner, ARRAY, length)
    return field_type(*inner, BOUNDED_SEQUENCE if length else SEQUENCE, length)


def description(type_name):
    fields = [{"name": name, "type": field_type(*what)} for name, what in ros2_types().fielddefs[type_name][1]]
    return {"type_name": type_name, "fields": fields}


def nested(type_name, found=None):
    found = {} if found is None else found
    for field in description(type_name)["fields"]:
        inner = field["type"]["nested_type_name"]
        if inner and inner not in found:
            found[inner] = description(inner)
            nested(inner, found)
    return found


def rihs01(type_name):
    others = nested(type_name)
    whole = {"type_description": description(type_name), "referenced_type_descriptions": [others[k] for k in sorted(others)]}
    return "RIHS01_" + hashlib.sha256(json.dumps(whole, separators=(", ", ": ")).encode()).hexdigest()


TYPES = {GRAPH.type_name, topics.POSE.type_name, topics.DETECTIONS.type_name, topics.TF.type_name, topics.CLOCK.type_name,
         topics.MARKERS.type_name, topics.TRACKED.type_name, *topics.BODY_PARTS.values()}  # fmt: skip


@pytest.mark.parametrize("type_name", sorted(TYPES))
def test_the_hash_is_that_of_the_definition(type_name):
    assert type_hash(type_name) == rihs01(type_name)


def test_known_hashes():
    # as the real ROS 2 Jazzy announces it
    assert type_hash(GRAPH.type_name).startswith("RIHS01_91a059")

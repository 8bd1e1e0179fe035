"""Graph models of TensorFlow.js as frozen TensorFlow graphs, which OpenVINO reads: the same nodes, and the weights inside them.

A graph model is a JSON file, whose nodes are TensorFlow's GraphDef in the JSON form of protocol buffers, and a binary file of
weights. Field numbers: graph.proto, node_def.proto, attr_value.proto, tensor.proto and tensor_shape.proto of TensorFlow.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posefuse.core import ModelError

# of each message: field -> (number, kind of its value, see _field)
_FIELDS: dict[str, dict[str, tuple[int, str]]] = {
    "graph": {"node": (1, "node")},
    "node": {"name": (1, "text"), "op": (2, "text"), "input": (3, "text"), "attr": (5, "attributes")},
    "attribute": {
        "list": (1, "attribute"), "s": (2, "bytes"), "i": (3, "integer"), "f": (4, "float"), "b": (5, "integer"),
        "type": (6, "type"), "shape": (7, "shape"), "tensor": (8, "tensor"),
    },
    "shape": {"dim": (2, "dimension"), "unknownRank": (3, "integer")},
    "dimension": {"size": (1, "integer")},
    "tensor": {"dtype": (1, "type"), "tensorShape": (2, "shape"), "tensorContent": (4, "bytes")},
}  # fmt: skip
_TYPES = {"DT_FLOAT": 1, "DT_INT32": 3, "DT_BOOL": 10}
_WEIGHTS: dict[str, tuple[str, Any]] = {
    "float32": ("DT_FLOAT", np.float32),
    "int32": ("DT_INT32", np.int32),
    "bool": ("DT_BOOL", np.bool_),
}
# operations that TensorFlow.js computes in one step, and what they begin with
_FUSED = {"_FusedConv2D": "Conv2D", "FusedDepthwiseConv2dNative": "DepthwiseConv2dNative"}


def frozen_graph(model: bytes, weights: bytes) -> bytes:
    """The serialised GraphDef, which depends on nothing but the content of the two files.

    Args:
        model: the JSON file. weights: the binary file.

    Raises:
        ModelError: no graph model, or one with what is not read here: other types of weights than 32 bit and 16 bit floats, 32
            bit integers and booleans.
    """
    try:
        content = json.loads(model)
        values = _tensors([one for group in content["weightsManifest"] for one in group["weights"]], weights)
        nodes = [part for node in content["modelTopology"]["node"] for part in _plain(node, values)]
        return _message("graph", {"node": nodes})
    except (KeyError, TypeError, ValueError, AttributeError, struct.error) as error:
        raise ModelError(f"not a graph model of TensorFlow.js that can be read ({type(error).__name__}: {error})") from None


def _tensors(manifest: Sequence[Mapping[str, Any]], content: bytes) -> dict[str, dict[str, Any]]:
    """The weights by name, as tensors of a GraphDef; 16 bit floats get 32."""
    tensors: dict[str, dict[str, Any]] = {}
    begin = 0
    for weight in manifest:
        name, element = _WEIGHTS[weight["dtype"]]
        stored = np.dtype(weight["quantization"]["dtype"] if "quantization" in weight else element)
        if "quantization" in weight and stored != np.float16:
            raise ValueError(f"weights of {stored}")
        count = int(np.prod(weight["shape"]))
        values = np.frombuffer(content, stored.newbyteorder("<"), count, begin).astype(element)
        begin += count * stored.itemsize
        shape = {"dim": [{"size": size} for size in weight["shape"]]}
        tensors[weight["name"]] = {"dtype": name, "tensorShape": shape, "tensorContent": values.tobytes()}
    return tensors


def _plain(node: Mapping[str, Any], values: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The nodes of one node: its weights filled in, and fused operations one after the other."""
    attributes = node.get("attr", {})
    if node["op"] == "Const":
        return [{**node, "attr": {**attributes, "value": {"tensor": values[node["name"]]}}}]
    if node["op"] not in _FUSED:
        return [dict(node)]
    steps = [base64.b64decode(step).decode() for step in attributes["fused_ops"]["list"]["s"]]
    image, kernel, *others = node["input"]
    names = [*(f"{node['name']}/step{i}" for i in range(len(steps))), node["name"]]
    first = {key: value for key, value in attributes.items() if key not in ("fused_ops", "num_args", "epsilon")}
    nodes = [{"name": names[0], "op": _FUSED[node["op"]], "input": [image, kernel], "attr": first}]
    for before, name, step in zip(names, names[1:], steps, strict=False):
        more = [others.pop(0)] if step == "BiasAdd" else []
        nodes.append({"name": name, "op": step, "input": [before, *more], "attr": {"T": attributes["T"]}})
    if others:
        raise ValueError(f"{node['name']}: fused with {steps}")
    return nodes


def _message(kind: str, content: Mapping[str, Any]) -> bytes:
    """A message of `_FIELDS`; fields that are not there are left out."""
    encoded = b""
    for field, value in content.items():
        if field in _FIELDS[kind]:
            number, of = _FIELDS[kind][field]
            encoded += b"".join(_field(number, of, one) for one in (value if isinstance(value, list) else [value]))
    return encoded


def _field(number: int, kind: str, value: Any) -> bytes:
    if kind == "attributes":
        return b"".join(_field(number, "bytes", _entry(name, one)) for name, one in value.items())
    if kind == "float":
        return _varint(number << 3 | 5) + struct.pack("<f", value)
    if kind in ("integer", "type"):
        return _varint(number << 3) + _varint(_TYPES[value] if kind == "type" else int(value))
    content: bytes
    if kind == "text":
        content = value.encode()
    elif kind == "bytes":
        content = value if isinstance(value, bytes) else base64.b64decode(value)
    else:
        content = _message(kind, value)
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _entry(name: str, value: Mapping[str, Any]) -> bytes:
    return _field(1, "text", name) + _field(2, "attribute", value)


def _varint(value: int) -> bytes:
    # 64 bits, negative numbers as their two's complement
    value &= (1 << 64) - 1
    encoded = bytearray()
    while value > 127:
        encoded.append(value & 127 | 128)
        value >>= 7
    return bytes([*encoded, value])

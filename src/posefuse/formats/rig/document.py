"""TOML, XML, YAML and JSON files parsed to plain values, OpenCV's and ROS's matrices included."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import yaml

from posefuse.core import CalibrationError
from posefuse.foundation.parsing import parse_json, parse_toml, parse_yaml, read_text

_MATRIX_TAG = "tag:yaml.org,2002:opencv-matrix"


class _Loader(yaml.SafeLoader):
    """YAML 1.1 plus OpenCV's matrix tag, and numbers like 1e-5 or 1.e-05, which YAML 1.1 takes for text."""


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor(_MATRIX_TAG, _matrix)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z"),
    list("-+0123456789."),
)


def read_document(path: Path) -> Any:
    """The content of a file: a mapping (.toml, .yaml, .yml, .json) or an XML element; None for anything else.

    Matrices written as rows, cols, data become nested lists.

    Raises:
        CalibrationError: it cannot be read, or does not match its name.
    """
    where, text = str(path), read_text(path, CalibrationError)
    if path.suffix == ".toml":
        return parse_toml(where, text, CalibrationError)
    if text.lstrip().startswith("<"):
        return _xml(path, text)
    if path.suffix == ".json":
        return _matrices(where, parse_json(where, text, CalibrationError))
    if path.suffix in (".yaml", ".yml"):
        # OpenCV's header is not the one the YAML standard has
        return _matrices(where, parse_yaml(where, re.sub(r"\A%YAML:.*\n", "", text), CalibrationError, _Loader))
    return None


def _xml(path: Path, text: str) -> ET.Element:
    if "<!ENTITY" in text or "<!DOCTYPE" in text:
        raise CalibrationError(f"{path}: XML with a DOCTYPE is not read")
    # the declared encoding no longer holds for decoded text
    try:
        return ET.fromstring(re.sub(r"\A\s*<\?xml.*?\?>", "", text))
    except (ET.ParseError, ValueError) as error:
        raise CalibrationError(f"{path}: cannot be parsed as XML ({' '.join(str(error).split())})") from None


def _matrices(where: str, value: Any) -> Any:
    if isinstance(value, list):
        return [_matrices(where, part) for part in value]
    if not isinstance(value, dict):
        return value
    if {"rows", "cols", "data"} <= set(value):
        rows, cols, data = value["rows"], value["cols"], value["data"]
        if not (isinstance(rows, int) and isinstance(cols, int) and isinstance(data, list) and len(data) == rows * cols):
            raise CalibrationError(f"{where}: matrix: expected rows x cols = {rows} x {cols} numbers in data, got {_count(data)}")
        return [data[i * cols : (i + 1) * cols] for i in range(rows)] if rows > 1 and cols > 1 else data
    return {key: _matrices(where, part) for key, part in value.items()}


def _count(data: Any) -> str:
    return str(len(data)) if isinstance(data, list) else type(data).__name__

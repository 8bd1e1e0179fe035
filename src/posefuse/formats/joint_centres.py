"""Tables of joint centres from TOML files, and from the mappings that results keep of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, field
from pathlib import Path
from typing import Any

from posefuse.core import ConfigError, JointCentres, ShapeError
from posefuse.foundation.settings import read_settings, settings, settings_from_mapping


@settings
class _Table:
    """The keys of a file, see `JointCentres`."""

    made_by: str
    offsets: dict[str, dict[str, float]]
    lengths: dict[str, float] = field(default_factory=dict)
    by_length: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)


def read_joint_centres(path: Path) -> JointCentres:
    """Read a table; raises ConfigError naming the file and what is wrong in it."""
    return _checked(read_settings(path, _Table), str(path))


def joint_centres_from_mapping(content: Mapping[str, Any], where: str) -> JointCentres:
    """The table that `dataclasses.asdict` made a mapping of; raises ConfigError naming `where` and what is wrong in it."""
    return _checked(settings_from_mapping(content, _Table, where), where)


def _checked(table: _Table, where: str) -> JointCentres:
    try:
        return JointCentres(**asdict(table))
    except (ConfigError, ShapeError) as error:
        raise ConfigError(f"{where}: {error}") from None

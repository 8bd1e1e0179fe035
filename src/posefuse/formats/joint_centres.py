"""Tables of joint centres as TOML files, and as the mappings that results keep of them."""

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


def joint_centres_text(table: JointCentres) -> str:
    """The table as TOML, as `read_joint_centres` reads it; to a tenth of a millimetre."""
    lines = [
        "# metres from the fused landmark to the joint centre along directions of the body itself, see tracking/joint_centres.py",
        f'made_by = "{table.made_by}"',
        *_section("lengths", table.lengths, 3),
    ]
    for joint, offsets in table.offsets.items():
        lines += _section(f"offsets.{joint}", offsets, 4)
    for joint, directions in table.by_length.items():
        for name, slopes in directions.items():
            lines += _section(f"by_length.{joint}.{name}", slopes, 3)
    return "\n".join(lines) + "\n"


def _section(name: str, values: Mapping[str, float], digits: int) -> list[str]:
    return ["", f"[{name}]", *(f"{key} = {value:.{digits}f}" for key, value in values.items())]

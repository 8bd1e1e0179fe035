"""Plug-ins by Python entry points: cameras, detectors, outputs recorded and live; those of posefuse are found in the same way."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from posefuse import core
from posefuse.core import ConfigError, DependencyError
from posefuse.core.errors import choices
from posefuse.core.extras import install_words

from .settings import settings_from_mapping

GROUPS = {
    "sources": "posefuse.sources",
    "detectors": "posefuse.detectors",
    "outputs": "posefuse.outputs",
    "live_outputs": "posefuse.live_outputs",
}
# what posefuse's own packages add, with the extra that installs it
OF_PACKAGES = {
    "sources": {"ros": "ros", "simulated": "sim"},
    "detectors": {"oracle": "sim"},
    "outputs": {"mcap": "ros"},
    "live_outputs": {"record": "ros", "ros1": "ros", "ros2": "ros"},
}
_OURS = ("posefuse", "posefuse_ros", "posefuse_sim")
# what a config builds; a live output is built in another process, so that its config is asked
# by name: help of commands needs none of what they import
_PROTOCOLS = {"sources": "Source", "detectors": "Detector", "outputs": "Sink", "live_outputs": "LiveOutputConfig"}


@dataclass(frozen=True)
class Plugin:
    """One entry point.

    Attributes:
        kind: key of `GROUPS`. name: how users call it. package: distribution it came with.
        config: its config class, None when it cannot be used. reason: why not, "" when it can.
    """

    kind: str
    name: str
    package: str
    config: type[Any] | None
    reason: str = ""


def list_plugins(kind: str) -> list[Plugin]:
    """All plug-ins of a kind by name; one that cannot be used is listed with its reason."""
    return [_loaded(kind, entry) for entry in sorted(entry_points(group=GROUPS[kind]), key=lambda entry: entry.name)]


def build_plugin(kind: str, name: str, options: Mapping[str, Any], known: Mapping[str, Any] | None = None) -> Any:
    """Build the plug-in `name`; see `plugin_config`. Raises ConfigError also where what it builds lacks a member."""
    built = plugin_config(kind, name, options, known).build()
    _check_members(kind, name, built)
    return built


def plugin_config(kind: str, name: str, options: Mapping[str, Any], known: Mapping[str, Any] | None = None) -> Any:
    """The config of plug-in `name`, made from `options`.

    Args:
        known: facts of the session by option name; a plug-in that has such an option gets it, unless `options` have it.

    Raises:
        ConfigError: no such plug-in, or options it does not take.
        DependencyError: it failed to import, or is no settings class.
    """
    entries = {entry.name: entry for entry in entry_points(group=GROUPS[kind])}
    if name not in entries and name in OF_PACKAGES.get(kind, {}):
        raise DependencyError(f"{kind} {name}: not installed; {install_words(OF_PACKAGES[kind][name])}")
    if name not in entries:
        raise ConfigError(f"no plug-in {name!r} among {kind}; there are: {choices(sorted(entries))}")
    plugin = _loaded(kind, entries[name])
    if plugin.config is None:
        raise DependencyError(f"plug-in {name} ({plugin.package}) cannot be used: {plugin.reason}")
    usual = {key: value for key, value in (known or {}).items() if key in option_names(plugin)}
    config = settings_from_mapping({**usual, **options}, plugin.config, where=f"{kind} {name}")
    if kind == "live_outputs":
        _check_members(kind, name, config)
    return config


def _check_members(kind: str, name: str, given: object) -> None:
    protocol = getattr(core, _PROTOCOLS[kind])
    members = [member for member in vars(protocol) if not member.startswith("_")]
    lacking = [member for member in (*protocol.__annotations__, *members) if not hasattr(given, member)]
    if lacking:
        expected = f"core.{protocol.__name__}"
        raise ConfigError(f"plug-in {name} among {kind}: {type(given).__name__} lacks {choices(lacking)} of {expected}")


def from_package(group: str, name: str, *, extra: str) -> Any:
    """What one of posefuse's own packages offers as ``posefuse.GROUP``; raises DependencyError without its extra."""
    for entry in entry_points(group=f"posefuse.{group}", name=name):
        return entry.load()
    raise DependencyError(f"{group} {name}: not installed; {install_words(extra)}")


def sources_of_others() -> list[str]:
    """Names of the sources that other packages bring, as they are given in ``CAMERA=NAME:WHERE``."""
    return sorted(entry.name for entry in entry_points(group=GROUPS["sources"]) if not is_ours(entry.module))


def is_ours(module: str) -> bool:
    """Whether a module is of one of our packages that bring plug-ins."""
    return module.partition(".")[0] in _OURS


def option_names(plugin: Plugin) -> list[str]:
    """Names of the options a plug-in takes."""
    return [field.name for field in dataclasses.fields(plugin.config)] if plugin.config else []


def _loaded(kind: str, entry: EntryPoint) -> Plugin:
    package = entry.dist.name if entry.dist else "unknown"
    try:
        config = entry.load()
    except Exception as error:  # noqa: BLE001 - others' code may fail in any way; it is listed, not hidden
        return Plugin(kind, entry.name, package, None, f"{type(error).__name__}: {error}")
    if not (isinstance(config, type) and dataclasses.is_dataclass(config) and hasattr(config, "build")):
        return Plugin(kind, entry.name, package, None, f"expected a settings class with build(), got {entry.value}")
    return Plugin(kind, entry.name, package, config)

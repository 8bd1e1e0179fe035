"""Calibrate: from cameras to a verified rig."""

from __future__ import annotations

from posefuse.studio.shell import title
from posefuse.studio.state import Studio


def build(studio: Studio) -> None:
    """Place the page."""
    title("Calibrate", f"Workspace {studio.workspace.root}")

"""Cameras: what there is to see with."""

from __future__ import annotations

from posefuse.studio.shell import title
from posefuse.studio.state import Studio


def build(studio: Studio) -> None:
    """Place the page."""
    title("Cameras", f"Workspace {studio.workspace.root}")

"""The elements that pages place: each draws what comes over the stream of its name."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

# importing it registers the bundled three.js under the name that the component imports
import nicegui.elements.scene  # noqa: F401
from nicegui.element import Element

from posefuse.core.palette import colour_of

VIEWS = {"home": "Overview", "top": "From above", "front": "Front", "side": "Side"}
"""Where a scene can be looked at from, see `RigScene.look`, and its words."""


class RigScene(Element, component="rig_scene.js", esm={"posefuse-studio": "lib"}):
    """3D: skeletons, ellipsoids, trails, cameras and floor.

    Args:
        stream: name of the stream.
        ellipsoids, trails, cameras: what is shown at first, with the skeletons.
    """

    def __init__(self, stream: str, *, ellipsoids: bool = True, trails: bool = False, cameras: bool = True) -> None:
        super().__init__()
        self._props.update(stream=stream, skeletons=True, ellipsoids=ellipsoids, trails=trails, cameras=cameras)
        self.classes("pf-scene")
        self.props('role="img" aria-label="3D view; drag to turn, wheel to zoom"')

    def show(self, **parts: bool) -> None:
        """Switch parts on or off: ``skeletons``, ``ellipsoids``, ``trails``, ``cameras``."""
        self._props.update(parts)
        self.update()

    def look(self, where: str) -> None:
        """One of `VIEWS`."""
        self.run_method("look", where)


class CameraTile(Element, component="camera_tile.js", esm={"posefuse-studio": "lib"}):
    """A camera's newest image with its overlay.

    Args:
        stream: name of the stream. camera: its number in the setup. aspect: width / height. overlay: draw keypoints.
    """

    def __init__(self, stream: str, camera: int, *, aspect: float = 4 / 3, overlay: bool = True, name: str = "") -> None:
        super().__init__()
        self._props.update(stream=stream, camera=camera, aspect=aspect, overlay=overlay)
        self.classes("pf-tile")
        self._props.update({"role": "img", "aria-label": f"camera {name or camera}"})

    @staticmethod
    def show(tiles: Iterable[CameraTile], overlay: bool) -> None:
        """Switch the overlay of some."""
        for tile in tiles:
            tile._props["overlay"] = overlay
            tile.update()


class ValuePlot(Element, component="value_plot.js", esm={"posefuse-studio": "lib"}):
    """A running plot of some values of a stream.

    Args:
        stream: name of the stream. places, names: numbers in the setup's plots and names of the values. unit: of all.
        seconds: how much of the past is shown.
    """

    def __init__(self, stream: str, places: list[int], names: list[str], *, unit: str = "deg", seconds: float = 10.0) -> None:
        super().__init__()
        self._props.update(curves(places, names), stream=stream, unit=unit, seconds=seconds)
        self.classes("pf-plot")

    def choose(self, places: list[int], names: list[str]) -> None:
        """Show other values."""
        self._props.update(curves(places, names))
        self.update()


def curves(places: list[int], names: list[str]) -> dict[str, Any]:
    """Properties of a plot of these values: each has the colour of its side of the body."""
    labels = [name.replace("_", " ") for name in names]
    return {"places": places, "labels": labels, "colours": [colour_of(name).on_light for name in names]}

"""The elements that pages place: each draws what comes over the stream of its name."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

# importing it registers the bundled three.js under the name that the component imports
import nicegui.elements.scene
from nicegui import ui
from nicegui.element import Element

from posefuse.core.palette import colour_of

# where a scene can be looked at from, and its words
_VIEWS = {"home": "Overview", "top": "From above", "front": "Front", "side": "Side"}
# of the body, those that most ask for first
_FIRST_JOINTS = ("knee", "hip")


class RigScene(Element, component="rig_scene.js", esm={"posefuse-studio": "lib"}):
    """3D: skeletons, ellipsoids, trails, cameras and floor.

    Args:
        stream: name of the stream.
        ellipsoids, trails: what is shown at first, with the skeletons and cameras.
    """

    def __init__(self, stream: str, *, ellipsoids: bool = True, trails: bool = False) -> None:
        super().__init__()
        self._props.update(stream=stream, skeletons=True, ellipsoids=ellipsoids, trails=trails, cameras=True)
        self.classes("pf-scene")
        self.props('role="img" aria-label="3D view; drag to turn, wheel to zoom"')

    def show(self, **parts: bool) -> None:
        """Switch parts on or off: ``skeletons``, ``ellipsoids``, ``trails``, ``cameras``."""
        self._props.update(parts)
        self.update()

    def view_buttons(self) -> None:
        """Place a button for each direction from which it can be looked at."""
        for where, text in _VIEWS.items():
            ui.button(text, on_click=partial(self.run_method, "look", where)).props("flat dense")


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
    def overlay_switch(tiles: Sequence[CameraTile]) -> None:
        """Place the switch for the overlay of some."""

        def show(on: bool) -> None:
            for tile in tiles:
                tile._props["overlay"] = on
                tile.update()

        ui.switch("Overlay", value=True, on_change=lambda event: show(event.value)).props("dense")


class ValuePlot(Element, component="value_plot.js", esm={"posefuse-studio": "lib"}):
    """A running plot of some angles of a stream, in degrees.

    Args:
        stream: name of the stream. places, names: numbers of the angles in its values, and their names.
    """

    def __init__(self, stream: str, places: list[int], names: list[str]) -> None:
        super().__init__()
        self._props.update(curves(places, names), stream=stream)
        self.classes("pf-plot")

    def choose(self, places: list[int], names: list[str]) -> None:
        """Show other values."""
        self._props.update(curves(places, names))
        self.update()


def curves(places: list[int], names: list[str]) -> dict[str, Any]:
    """Properties of a plot of these values: each has the colour of its side of the body."""
    labels = [name.replace("_", " ") for name in names]
    return {"places": places, "labels": labels, "colours": [colour_of(name).on_light for name in names]}


def first_angles(names: Sequence[str]) -> list[str]:
    """Those that are shown at first, of the names of angles: knees, or whatever there is."""
    for joint in _FIRST_JOINTS:
        if found := [name for side in ("left", "right") if (name := f"{side}_{joint} flexion") in names]:
            return found
    return list(names[:2])

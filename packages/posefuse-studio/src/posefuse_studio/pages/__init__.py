"""One module per page, each with ``build(studio)``, which places the elements of one visitor's page."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StudioPage:
    """An entry of the navigation.

    Attributes:
        module: in this package. path: of its address. title: one word. icon: name of a Material icon.
    """

    module: str
    path: str
    title: str
    icon: str


# in the order of the work
PAGES = (
    StudioPage("cameras", "/", "Cameras", "videocam"),
    StudioPage("calibrate", "/calibrate", "Calibrate", "straighten"),
    StudioPage("live", "/live", "Live", "sensors"),
    StudioPage("recordings", "/recordings", "Recordings", "movie"),
    StudioPage("simulate", "/simulate", "Simulate", "view_in_ar"),
)

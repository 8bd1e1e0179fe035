"""One module per page, each with ``build(studio)``, which places the elements of one visitor's page."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Page:
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
    Page("cameras", "/", "Cameras", "videocam"),
    Page("calibrate", "/calibrate", "Calibrate", "straighten"),
    Page("live", "/live", "Live", "sensors"),
    Page("recordings", "/recordings", "Recordings", "movie"),
    Page("simulate", "/simulate", "Simulate", "view_in_ar"),
)

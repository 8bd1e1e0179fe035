"""The colours of people and of their two sides wherever they are drawn: left orange, right blue, what is in the middle green.

Orange against blue is the pair that readers with any usual deficiency of colour vision distinguish (Okabe & Ito 2008).
"""

from __future__ import annotations

from typing import NamedTuple

RGB = tuple[int, int, int]


class SideColour(NamedTuple):
    """One colour. image_rgb: on images and in 3D. on_light, on_dark: CSS, for lines and text on a page of either kind."""

    image_rgb: RGB
    on_light: str
    on_dark: str


LEFT = SideColour((255, 140, 30), "#d2542c", "#f08a63")
RIGHT = SideColour((40, 160, 255), "#2468c9", "#6ea5f5")
MIDDLE = SideColour((90, 220, 110), "#4c7a51", "#86b98b")
# of people, by their ids in turn: light, for names on images and skeletons in 3D, and none of a side
PEOPLE: tuple[RGB, ...] = ((255, 255, 255), (255, 230, 80), (120, 240, 240), (255, 160, 220), (170, 255, 150), (200, 180, 255))
LEGEND = "Orange: left; blue: right; green: trunk."


def colour_of(keypoint: str) -> SideColour:
    """The colour of a keypoint by its name."""
    return LEFT if keypoint.startswith("left_") else RIGHT if keypoint.startswith("right_") else MIDDLE

"""What a user may set about calibration."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from posefuse.foundation.settings import settings

# squares of a board along one side, and a target of 10 m
_Squares = Annotated[int, Ge(1), Le(200)]
_Millimetres = Annotated[float, Gt(0), Le(10_000)]
# of paper, across and up
PAGES_M = {"a4": (0.210, 0.297), "a3": (0.297, 0.420), "a2": (0.420, 0.594), "a1": (0.594, 0.841), "a0": (0.841, 1.189),
           "letter": (0.2159, 0.2794)}  # fmt: skip
TargetKind = Literal["markers", "charuco", "chessboard"]


@settings
class TargetDescription:
    """The contents of a target file.

    Attributes:
        kind: what it is. columns, rows: squares (charuco), inner corners (chessboard).
        square_mm, marker_mm: edge of a square and of a marker's black square.
        dictionary: OpenCV's name of the marker dictionary. ids: markers of the target.
        inverted: black and white are exchanged. legacy: ChArUco layout of OpenCV before 4.6.
    """

    kind: TargetKind
    columns: _Squares | None = None
    rows: _Squares | None = None
    square_mm: _Millimetres | None = None
    marker_mm: _Millimetres | None = None
    dictionary: str = "DICT_4X4_50"
    ids: tuple[int, ...] = ()
    inverted: bool = False
    legacy: bool = False

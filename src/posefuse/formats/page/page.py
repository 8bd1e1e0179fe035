"""A page: frozen blocks in reading order, the 3D player among them, as one self-contained HTML file."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from posefuse.core import InputError, palette
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import write_text
from posefuse.foundation.summary import Block, Heading

from .plots import Arrays, Plots, plot_content, with_decimals


@dataclass(frozen=True)
class Page:
    """A whole page; every heading of level 2 begins a new section.

    Attributes:
        title: shown on top and in the browser's tab. blocks: in reading order. subtitle: a line under the title.
    """

    title: str
    blocks: Sequence[Block]
    _: KW_ONLY
    subtitle: str = ""


@dataclass(frozen=True)
class Cards:
    """A few names and values side by side, the values large."""

    values: Mapping[str, str]
    kind: ClassVar[str] = "cards"


@dataclass(frozen=True, eq=False)
class Images:
    """Captions to RGB images (H, W, 3) uint8, stored inside the page as JPEG."""

    images: Mapping[str, Array]
    kind: ClassVar[str] = "images"

    @property
    def shown(self) -> list[tuple[str, str]]:
        """Captions and ``data:`` addresses."""
        return [(caption, f"data:image/jpeg;base64,{_text_of(_encoded(image))}") for caption, image in self.images.items()]


@dataclass(frozen=True)
class Details:
    """Blocks folded away under a line that opens them; no headings inside."""

    summary: str
    blocks: Sequence[Block]
    kind: ClassVar[str] = "details"


def _encoded(image: Array) -> bytes:
    import cv2

    if image.ndim != 3 or image.shape[2] != 3 or not image.size or image.dtype != np.uint8:
        raise InputError(f"page: expected an RGB image (H, W, 3) uint8, got {image.shape} {image.dtype}")
    return cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes()


Side = Literal["left", "right", "mid"]
_MOST_HZ = 30.0
_MOST_FRAMES = 5400
# a millimetre and a millisecond, which no screen shows
_DECIMALS = 3


@dataclass(frozen=True, eq=False)
class Player:
    """Stick figures over time, drawn by the page itself.

    Kept are at most 30 time steps per second and the first 5400 of those, positions to 1 mm.

    Attributes:
        t_s: (T,) seconds, growing. xyz_m: (T, N, K, 3) metres, Z up; NaN where missing.
        bones: (B, 2) places of keypoints. sides: of every bone, for its colour. people: a name for each of N.
        right_left: pairs of keypoints by which the page knows where a person faces, e.g. the hips; none: towards +x.
    """

    t_s: Array
    xyz_m: Array
    _: KW_ONLY
    bones: Array
    sides: Sequence[Side]
    people: Sequence[str]
    right_left: Sequence[tuple[int, int]] = ()
    kind: ClassVar[str] = "player"

    def __post_init__(self) -> None:
        shape = np.shape(self.xyz_m)
        if len(shape) != 4 or shape[0] != len(self.t_s) or shape[1] != len(self.people) or shape[3] != 3:
            raise InputError(
                f"player: expected positions ({len(self.t_s)}, {len(self.people)}, K, 3) of as many times and people, got {shape}"
            )
        if len(self.bones) != len(self.sides):
            raise InputError(f"player: expected a side for each of {len(self.bones)} bones, got {len(self.sides)}")

    @property
    def kept(self) -> Array:
        """Places (T',) of the time steps that are stored."""
        if len(self.t_s) < 2:
            return np.arange(len(self.t_s))
        period_s = float(np.median(np.diff(self.t_s)))
        step = max(1, round(1 / (_MOST_HZ * period_s))) if period_s > 0 else 1
        return np.arange(0, len(self.t_s), step)[:_MOST_FRAMES]

    @property
    def note(self) -> str:
        """What is left out, in words; empty if nothing is."""
        kept = self.kept
        if not len(kept) or kept[-1] + (kept[1] - kept[0] if len(kept) > 1 else 1) >= len(self.t_s):
            return ""
        return f"The first {self.t_s[kept[-1]] - self.t_s[0]:.0f} s of {self.t_s[-1] - self.t_s[0]:.0f} s."


def player_content(player: Player) -> dict[str, Any]:
    """A player as the page's script reads it: one array per person, keypoint and axis."""
    kept = player.kept
    xyz = np.asarray(player.xyz_m[kept], float)
    return {
        "t": with_decimals(np.asarray(player.t_s, float)[kept], _DECIMALS),
        "people": [
            {"name": name, "xyz": [[with_decimals(xyz[:, n, k, i], _DECIMALS) for i in range(3)] for k in range(xyz.shape[2])]}
            for n, name in enumerate(player.people)
        ],
        "bones": np.asarray(player.bones).tolist(),
        "sides": list(player.sides),
        "across": [list(pair) for pair in player.right_left],
    }


_HERE = Path(__file__).parent
PLOTLY = _HERE / "assets" / "plotly-basic-4.1.1.min.js.gz"


def write_page(path: Path, page: Page) -> Path:
    """Write a page that needs no other file and no network, whole or not at all; returns `path`.

    Plots are drawn in any browser since 2023, in the colours of a light or dark system; the print style sheet makes a PDF.

    Raises:
        InputError: no such folder, or it cannot be written to; an image that cannot be shown.
    """
    html = page_html(page)
    write_text(path, html)
    return path


def page_html(page: Page) -> str:
    """The text of the file."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    content = page_content(page)
    return environment.get_template("page.html.j2").render(
        page=page,
        sections=_sections(page.blocks),
        data=_text_of(gzip.compress(json.dumps(content, separators=(",", ":"), allow_nan=False).encode(), 9, mtime=0)),
        plotly=_text_of(PLOTLY.read_bytes()) if content["plots"] else "",
        has_player=bool(content["players"]),
        left=palette.LEFT,
        right=palette.RIGHT,
        middle=palette.MIDDLE,
    )


def page_content(page: Page) -> dict[str, Any]:
    """What the page's script draws: arrays, plots and players, each list in the order in which the page shows them."""
    arrays, blocks = Arrays(), list(_all(page.blocks))
    plots = [plot_content(plot, arrays) for block in blocks if isinstance(block, Plots) for plot in block.plots]
    players = [player_content(block) for block in blocks if isinstance(block, Player)]
    return {"title": page.title, "arrays": arrays.content, "plots": plots, "players": players}


def _all(blocks: Sequence[Block]) -> Iterator[Block]:
    for block in blocks:
        yield block
        if isinstance(block, Details):
            yield from _all(block.blocks)


def _sections(blocks: Sequence[Block]) -> list[list[Block]]:
    """Blocks by section: each heading of level 2 begins one."""
    sections: list[list[Block]] = [[]]
    for block in blocks:
        if isinstance(block, Heading) and block.level == 2:
            sections.append([])
        sections[-1].append(block)
    return [section for section in sections if section]


def _text_of(data: bytes) -> str:
    return base64.b64encode(data).decode()

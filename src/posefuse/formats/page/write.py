"""A page as one self-contained HTML file."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from posefuse.core import palette
from posefuse.foundation.output_file import write_text
from posefuse.foundation.summary import Block, Heading

from .blocks import Details, Page, Player, player_content
from .plots import Arrays, Plots, plot_content

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

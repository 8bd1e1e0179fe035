"""Which cameras share views of a target, as a drawing: what links them into one rig, and what is missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import combinations

from posefuse.calibration.targets.coverage import ENOUGH_TOGETHER

_SIZE_WH = (560, 360)
_MARGIN_PX, _NODE_PX = 56, 15
_GOOD, _DOUBT, _BAD = "#2e9e57", "#f9a825", "#e53935"


@dataclass(frozen=True, kw_only=True)
class Link:
    """Two cameras, by place, and the moments at which both saw the target."""

    a: int
    b: int
    count: int

    @property
    def enough(self) -> bool:
        """Whether they are linked well enough for a calibration."""
        return self.count >= ENOUGH_TOGETHER


def links(together: Sequence[Sequence[int]]) -> list[Link]:
    """Pairs that share any moment; `together` is (C, C) as in `TargetCoverage`."""
    pairs = (Link(a=a, b=b, count=int(together[a][b])) for a, b in combinations(range(len(together)), 2))
    return [pair for pair in pairs if pair.count > 0]


def graph_words(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> str:
    """The text alternative of the drawing."""
    found = links(together)
    pairs = [f"{cameras[one.a]} and {cameras[one.b]} {one.count}{'' if one.enough else ', too few'}" for one in found]
    alone = [name for c, name in enumerate(cameras) if not any(c in (one.a, one.b) for one in found)]
    return "; ".join([*pairs, *(f"{name} shares none" for name in alone)])


def graph_svg(cameras: Sequence[str], together: Sequence[Sequence[int]]) -> str:
    """Cameras on a circle; lines with counts: green from `ENOUGH_TOGETHER` moments on, yellow below. A camera without is red."""
    found = sorted(links(together), key=lambda one: one.count)
    at = [_place(c, len(cameras)) for c in range(len(cameras))]
    parts = [_edge(at[one.a], at[one.b], one) for one in found]
    parts += [_count(at[one.a], at[one.b], one) for one in found]
    for c, name in enumerate(cameras):
        own = [one for one in found if c in (one.a, one.b)]
        parts.append(_node(at[c], name, _GOOD if any(one.enough for one in own) else _DOUBT if own else _BAD))
    width, height = _SIZE_WH
    return (
        f'<svg viewBox="0 0 {width} {height}" width="100%" style="max-width:{width}px" role="img" font-family="Roboto"'
        f' aria-label="{escape(graph_words(cameras, together), quote=True)}">{"".join(parts)}</svg>'
    )


def _place(c: int, count: int) -> tuple[float, float]:
    width, height = _SIZE_WH
    angle = 2 * math.pi * c / count - math.pi / 2
    return width / 2 + (width / 2 - _MARGIN_PX) * math.cos(angle), height / 2 + (height / 2 - _MARGIN_PX) * math.sin(angle)


def _edge(a: tuple[float, float], b: tuple[float, float], link: Link) -> str:
    thick = 2 + 4 * min(link.count / ENOUGH_TOGETHER, 1.0)
    dashes = "" if link.enough else ' stroke-dasharray="7 5"'
    return (
        f'<line x1="{a[0]:.0f}" y1="{a[1]:.0f}" x2="{b[0]:.0f}" y2="{b[1]:.0f}" stroke="{_GOOD if link.enough else _DOUBT}" '
        f'stroke-width="{thick:.1f}"{dashes}/>'
    )


def _count(a: tuple[float, float], b: tuple[float, float], link: Link) -> str:
    # off the middle, where the lines of opposite cameras cross
    x, y = (0.62 * p + 0.38 * q for p, q in zip(a, b, strict=True))
    return (
        f'<rect x="{x - 19:.0f}" y="{y - 11:.0f}" width="38" height="21" rx="6" fill="var(--pf-card)" stroke="var(--pf-line)"/>'
        f'<text x="{x:.0f}" y="{y + 5:.0f}" font-size="13" text-anchor="middle" fill="currentColor">{link.count}</text>'
    )


def _node(at: tuple[float, float], name: str, colour: str) -> str:
    x, y = at
    text_y = y - _NODE_PX - 7 if y < _SIZE_WH[1] / 2 else y + _NODE_PX + 17
    return (
        f'<circle cx="{x:.0f}" cy="{y:.0f}" r="{_NODE_PX}" fill="{colour}"/>'
        f'<text x="{x:.0f}" y="{text_y:.0f}" font-size="14" font-weight="600" text-anchor="middle" fill="currentColor">'
        f"{escape(name)}</text>"
    )

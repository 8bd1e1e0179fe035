"""A calibration's report as one self-contained HTML page: checks, numbers, coverage pictures, a plan of the cameras."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping

import cv2
import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array

from .report import CalibrationReport

_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}"
    "table{border-collapse:collapse;width:100%}td,th{text-align:left;padding:.3rem .6rem;border-bottom:1px solid #ddd;"
    "vertical-align:top}.pass{color:#1b7a3a}.fail{color:#b3261e;font-weight:700}figure{display:inline-block;margin:.5rem}"
    "figcaption{font-size:.85rem}img{max-width:27rem;width:100%}svg{max-width:100%;border:1px solid #ddd}"
)
_PLAN_PX, _PLAN_MARGIN = 560, 60


def html_page(report: CalibrationReport, pictures: Mapping[str, Array] | None = None, rig: Rig | None = None) -> str:
    """The page. `pictures` maps captions to RGB images (H, W, 3); `rig` adds a plan of the cameras."""
    verdict = "passed" if not report.failed else f"refused: {report.failed[0].name}"
    rows = "".join(
        f"<tr><td class={'pass' if check.passed else 'fail'}>{'pass' if check.passed else 'FAIL'}</td>"
        f"<td>{html.escape(check.name)}</td><td>{html.escape(check.line)}</td></tr>"
        for check in report.checks
    )
    numbers = "".join(f"<tr><td>{html.escape(name)}</td><td>{value:.4g}</td></tr>" for name, value in report.numbers.items())
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in report.notes)
    figures = "".join(_figure(caption, image) for caption, image in (pictures or {}).items())
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{html.escape(report.subject)}</title><style>{_STYLE}</style>",
        f"<h1>{html.escape(report.subject)}: {html.escape(verdict)}</h1><h2>Checks</h2><table>{rows}</table>",
        f"<h2>Notes</h2><ul>{notes}</ul>" if notes else "",
        f"<h2>Cameras from above</h2>{_plan(rig)}" if rig is not None else "",
        f"<h2>Pictures</h2>{figures}" if figures else "",
        f"<h2>Numbers</h2><table>{numbers}</table>" if numbers else "",
        "</html>",
    ]
    return "\n".join(part for part in parts if part)


def heat_picture(values: Array, size_wh: tuple[int, int], full: float) -> Array:
    """RGB picture (H, W, 3) of values (rows, columns) over an image: green 0, red `full` and more, grey NaN."""
    level = np.clip(np.nan_to_num(values) / full, 0, 1)[..., None]
    colours = np.array([40, 170, 80]) * (1 - level) + np.array([200, 60, 40]) * level
    colours = np.where(np.isnan(values)[..., None], 128, colours).astype(np.uint8)
    picture = cv2.resize(colours, size_wh, interpolation=cv2.INTER_NEAREST)
    rows, columns = values.shape
    for row, column in np.argwhere(np.isfinite(values)):
        at = (round((column + 0.15) * size_wh[0] / columns), round((row + 0.6) * size_wh[1] / rows))
        cv2.putText(picture, f"{values[row, column]:.1f}", at, cv2.FONT_HERSHEY_SIMPLEX, size_wh[0] / 1600, (255, 255, 255), 1)
    return np.asarray(picture)


def _figure(caption: str, image: Array) -> str:
    done, data = cv2.imencode(".png", cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2BGR))
    assert done
    text = base64.b64encode(data.tobytes()).decode()
    return f'<figure><img alt="" src="data:image/png;base64,{text}"><figcaption>{html.escape(caption)}</figcaption></figure>'


def _plan(rig: Rig) -> str:
    """Cameras seen from above, x to the right, y up, with the way they look, their heights, and a scale of 1 m."""
    centres = rig.centres_world()
    ahead = np.stack([camera.cam_from_world.matrix()[2] for camera in rig])
    low, high = np.minimum(centres[:, :2].min(axis=0), 0), np.maximum(centres[:, :2].max(axis=0), 0)
    scale = (_PLAN_PX - 2 * _PLAN_MARGIN) / max(float((high - low).max()), 1e-6)

    def px(xy: Array) -> tuple[float, float]:
        return _PLAN_MARGIN + (xy[0] - low[0]) * scale, _PLAN_PX - _PLAN_MARGIN - (xy[1] - low[1]) * scale

    x0, y0 = px(np.zeros(2))
    shapes = [
        f'<path d="M{x0:.0f} {y0:.0f}h{scale:.0f}" stroke="#b3261e" stroke-width="2"/>',
        f'<path d="M{x0:.0f} {y0:.0f}v-{scale:.0f}" stroke="#1b7a3a" stroke-width="2"/>',
        f'<text x="{x0 + 4:.0f}" y="{y0 + 14:.0f}" font-size="11">origin; arrows are 1 m</text>',
    ]
    for camera, centre, look in zip(rig, centres, ahead, strict=True):
        x, y = px(centre[:2])
        x2, y2 = px(centre[:2] + look[:2] * 40 / scale)
        shapes.append(f'<path d="M{x:.0f} {y:.0f}L{x2:.0f} {y2:.0f}" stroke="#333" stroke-width="2"/>')
        shapes.append(f'<circle cx="{x:.0f}" cy="{y:.0f}" r="6" fill="#2a6fb0"/>')
        label = f"{html.escape(camera.name)} ({centre[2]:.2f} m up)"
        shapes.append(f'<text x="{x + 9:.0f}" y="{y - 6:.0f}" font-size="12">{label}</text>')
    return f'<svg viewBox="0 0 {_PLAN_PX} {_PLAN_PX}" width="{_PLAN_PX}">{"".join(shapes)}</svg>'

"""Two recordings of one movement: `posefuse.compare`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from posefuse import core

from .arguments import checked

if TYPE_CHECKING:
    from posefuse.evaluation.compare import Comparison


@checked
def compare(
    a: core.Recording | str | Path,
    b: core.Recording | str | Path,
    *,
    person: int | None = None,
    align_time: bool = True,
    align_space: bool = True,
    scale: bool = False,
    align_first_s: float | None = None,
) -> Comparison:
    """Bring `b` onto `a` in time and space and measure their distance point by point, and their drift.

    Args:
        a: a recording, a result folder, or a file of another system: TRC, C3D, CSV, MVNX.
        b: the same.
        person: id in posefuse recordings; None: the one seen longest.
        align_time: find the offset in time.
        align_space: find the rotation and translation between the two world frames; recordings of one calibration share theirs,
            and are aligned in space only with `scale` or `align_first_s`.
        scale: find a change of size as well.
        align_first_s: align by the first seconds only, so that drift shows.

    Returns:
        The errors; `Comparison.save` writes a page with every point over time, and the figures.

    Raises:
        InputError: a file that cannot be read, no common points, or no common time. ConfigError: `scale` or `align_first_s`
            without `align_space`.

    Examples:
        >>> import posefuse as pf
        >>> found = pf.compare("RESULT", "markers.c3d")  # doctest: +SKIP
        >>> found.errors.mpjpe_mm, dict(zip(found.points, found.errors.mean_mm))  # doctest: +SKIP
    """
    from posefuse.pipeline.reports import compared

    one, two = _named(a, "a"), _named(b, "b")
    return compared(one, two, person, time=align_time, space=align_space, scale=scale, start_s=align_first_s)


def _named(value: core.Recording | str | Path, name: str) -> Path | tuple[Path, core.Recording]:
    if isinstance(value, core.Recording):
        path = getattr(value, "path", None)
        return path or Path(str(value.provenance.get("session", name))), value
    return Path(value)

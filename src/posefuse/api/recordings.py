"""What there is: `posefuse.recordings`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from posefuse.pipeline.catalogue import Listed


def recordings(folder: str | Path, *, search: str = "") -> list[Listed]:
    """The results and live recordings below a folder with how good each is, the newest first.

    What was found out is kept in the cache folder: the second time takes a fraction of the first.

    Args:
        folder: looked through, five folders deep; at most 2000 recordings. search: words of path, session, date or people.

    Returns:
        One entry each; those that cannot be read have a `problem`.

    Raises:
        InputError: no such folder.

    Examples:
        >>> import posefuse as pf
        >>> [one.path.name for one in pf.recordings("STUDY", search="walk") if one.sigma_mm > 20]  # doctest: +SKIP
        ['P03_walk2']
    """
    from posefuse.core import InputError
    from posefuse.pipeline.catalogue import find_recordings, listed

    place = Path(folder)
    if not place.is_dir():
        raise InputError(f"{place}: no such folder")
    return [one for path in find_recordings(place) if (one := listed(path)).matches(search)]

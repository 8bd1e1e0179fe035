"""Where things that can be had again are kept for the user: model files, compiled kernels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path


def default_cache_dir(environ: Mapping[str, str]) -> Path:
    """The user's cache folder: POSEFUSE_CACHE, else XDG_CACHE_HOME/posefuse, else ~/.cache/posefuse."""
    if environ.get("POSEFUSE_CACHE"):
        return Path(environ["POSEFUSE_CACHE"])
    base = environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "posefuse"

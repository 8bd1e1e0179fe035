"""Where things that can be had again are kept for the user: model files, compiled kernels."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def default_cache_dir() -> Path:
    """The user's cache folder: POSEFUSE_CACHE, else the system's place for caches (Linux: XDG_CACHE_HOME or ~/.cache)."""
    if own := os.environ.get("POSEFUSE_CACHE"):
        return Path(own)
    return Path(platformdirs.user_cache_dir("posefuse", appauthor=False))

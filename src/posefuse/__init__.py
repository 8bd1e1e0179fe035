"""posefuse: several ordinary cameras + AI -> one accurate 3D human skeleton, with honest uncertainty.

xyz, cov, reproj = posefuse.triangulate(posefuse.read_rig("rig.toml"), xy_img, score)
"""

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .formats.rig import read_rig
    from .fusion import triangulate

__all__ = ["__version__", "read_rig", "triangulate"]

_HOMES = {"triangulate": "posefuse.fusion", "read_rig": "posefuse.formats.rig"}


def __getattr__(name: str) -> Any:
    """Import a public function when it is first asked for, so that `import posefuse` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'posefuse' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)

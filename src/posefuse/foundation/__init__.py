"""What does not know cameras or people: safe writing, settings, compiled kernels, plug-ins, the platform."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .output_file import atomic_file, earlier_kept
    from .output_folder import growing_folder
    from .parsing import plain
    from .platform import usable_cores
    from .plugins import build_plugin
    from .progress_bars import stage_bars
    from .settings import settings_from_mapping

__getattr__ = lazy_names(__name__, __file__)

"""The live pipeline: camera groups in processes of their own, one steady fusion loop, outputs next to it."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .config import LiveConfig
    from .inputs import inputs_from_arguments
    from .latency import ViewTimes
    from .messages import LivePlan, SessionClock
    from .session import run_live

__getattr__ = lazy_names(__name__, __file__)

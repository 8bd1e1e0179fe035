"""`posefuse record`."""

from __future__ import annotations

from posefuse.cli.options.record import RecordOptions
from posefuse.cli.options.shared import Figures, Ros2Options, Shown


def record(*, options: RecordOptions, ros_2: Ros2Options = Ros2Options(), terminal: Shown) -> Figures:
    """Record cameras: one video per camera on one clock, for calibration or tracking.

    Frames keep their own times and, where a camera encodes, its own packets. Rates, drops and exposure are watched.
    """
    from posefuse.cli.recording import record_session

    return record_session(options, ros_2, terminal)

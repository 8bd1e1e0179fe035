"""The Python reference: which names it lists, and in what order. mkdocstrings reads their docstrings."""

from __future__ import annotations

import inspect

import posefuse

# what `import posefuse` offers, grouped by what one does with it
GROUPS: tuple[tuple[str, tuple[str, ...]], ...] = (
    (
        "Recordings",
        (
            "track",
            "read",
            "Recording",
            "Edits",
            "Exclusion",
            "batch",
            "compare",
            "plan",
            "simulate",
            "gazebo_world",
            "solve",
            "demo_session",
        ),
    ),
    ("Live", ("live", "track_live", "record", "resume_recording", "camera_node", "fusion_node", "teleoperate")),
    ("Cameras", ("read_rig", "Rig", "Camera", "triangulate")),
    (
        "Calibration",
        ("calibrate_intrinsics", "calibrate_extrinsics", "calibrate_person", "calibrate_clocks", "verify", "print_target"),
    ),
    ("Detectors", ("detector", "Detections2D")),
    ("Values", ("Observations", "Pose3D", "PoseSequence", "JointAngles", "Skeleton")),
    ("This machine", ("doctor", "models", "plugins")),
    ("Progress and errors", ("Progress", "PosefuseError")),
)


def api_page() -> str:
    """Markdown with one mkdocstrings block per public name.

    Raises:
        ValueError: a public name that no group lists, so that none is forgotten.
    """
    grouped = {name for _, names in GROUPS for name in names}
    public = {name for name in posefuse.__all__ if not name.startswith("_")}
    if grouped != public:
        raise ValueError(f"tools/docs_site/api.py and posefuse.__all__ differ in: {', '.join(sorted(grouped ^ public))}")
    parts = [
        "# Python reference\n",
        "This page is generated from the docstrings. `import posefuse as pf` offers these names; "
        "[From Python](../python.md) shows how they work together.\n",
    ]
    for title, names in GROUPS:
        parts.append(f"## {title}\n")
        parts += [_block(name) for name in names]
    return "\n".join(parts)


def _block(name: str) -> str:
    value = getattr(posefuse, name)
    path = f"{inspect.unwrap(value).__module__}.{value.__qualname__}"
    return f"::: {path}\n    options:\n      heading: posefuse.{name}\n      toc_label: {name}\n"

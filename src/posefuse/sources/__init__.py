"""Video files, image folders and cameras to frames; one file per kind."""

from .coverage import CountedSource, Coverage, DepthSource, RecordedSource, incomplete_cameras
from .grouping import FramesAhead, FrameSet, frame_sets
from .images import IMAGE_SUFFIXES, ImagesConfig, ImagesSource
from .seeking import ImagesSeeker, Seeker, VideoSeeker, nearest
from .video import VIDEO_SUFFIXES, VideoConfig, VideoSource

__all__ = [
    "IMAGE_SUFFIXES", "VIDEO_SUFFIXES", "CountedSource", "Coverage", "DepthSource", "FrameSet", "FramesAhead", "ImagesConfig",
    "ImagesSeeker", "ImagesSource", "RecordedSource", "Seeker", "VideoConfig", "VideoSeeker", "VideoSource", "frame_sets",
    "incomplete_cameras", "nearest",
]  # fmt: skip

"""Video files, image folders and cameras to frames; one file per kind."""

from .coverage import CountedSource, Coverage, DepthSource, RecordedSource, incomplete_cameras
from .grouping import FramesAhead, FrameSet, frame_sets
from .images import IMAGE_SUFFIXES, ImagesConfig, ImagesSource
from .seeking import Seeker, nearest
from .video import VIDEO_SUFFIXES, VideoConfig, VideoSource

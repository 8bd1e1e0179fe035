"""Results to the world: one file per output. Those that show images take them from one pass, see `frames`."""

from .drawing import view_tile
from .frames import Frames, FrameSets, FrameSink, write_outputs

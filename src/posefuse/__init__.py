"""posefuse: several ordinary cameras + AI -> one accurate 3D human skeleton."""

__version__ = "0.1.0"

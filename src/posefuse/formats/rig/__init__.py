"""Calibrated rigs from and to files: one module per kind of file, reader and writer side by side."""

from .image_size import fit_camera_to_video, rescaled_cameras
from .reading import read_placed_rig, read_rig, refusal_note, rig_warnings, write_rig

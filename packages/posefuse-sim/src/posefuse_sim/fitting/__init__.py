"""Fits to simulated people: noise of keypoints and their offsets to joint centres, for any detector."""

from .joint_centres import Run, fit_joint_centres
from .keypoint_noise import NoiseFit, NoiseSamples, collect, fit_noise, noise_text
from .scenes import is_rendered, render_everyday, render_moving

"""Extrinsics from a moving target: start values, bundle adjustment, the world frame, self-checks."""

"""Numerics that several calibrations share: bundle adjustment, projection with derivatives, rotations."""

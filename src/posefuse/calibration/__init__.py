"""Observations to Rig."""

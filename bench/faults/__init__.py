"""Constructed faults of calibration sessions, each with the cause that must be named."""

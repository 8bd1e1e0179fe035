"""Fixtures of the tests that need ROS 1."""

from ros1_master import alone, ros1_python  # noqa: F401

"""Pose3D and single views over time to Pose3D: the only room with memory."""

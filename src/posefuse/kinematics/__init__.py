"""Pose3D to Joints: segment frames and joint angles."""

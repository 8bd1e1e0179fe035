"""Extrinsics from a person who walks through the volume."""

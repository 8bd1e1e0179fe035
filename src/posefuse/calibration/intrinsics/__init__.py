"""Intrinsics of one camera."""

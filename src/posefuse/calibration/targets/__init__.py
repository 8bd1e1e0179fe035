"""Markers and boards: what they are, printing them, finding their corners in images, coverage while they are moved."""

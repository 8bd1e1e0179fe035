"""A scene with exact truth to frames and detections."""

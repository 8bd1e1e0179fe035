"""Images to Detections2D: 2D estimators, their models and their noise."""

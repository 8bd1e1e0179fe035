"""Views to Pose3D of one instant: weighted least squares, robust terms, covariance."""

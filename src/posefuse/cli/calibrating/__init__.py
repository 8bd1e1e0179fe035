"""What `posefuse calibrate` does around the calibration: one module per kind of step."""

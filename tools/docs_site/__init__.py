"""What the documentation site makes from the code: command line, settings, Python reference, images."""

"""The front door: recordings, rigs and the functions that make them, as `import posefuse` offers them."""

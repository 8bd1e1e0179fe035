"""The paper's experiments, run end to end: render, find, fuse, compare with the truth, report."""

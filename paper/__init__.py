"""The experiments of the paper, rendered, tracked and reported; not part of the package."""

"""Core values to and from files that more than one room reads or writes: rigs, truth, videos, TRC, settings."""

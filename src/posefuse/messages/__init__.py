"""Core values to and from messages on a network."""

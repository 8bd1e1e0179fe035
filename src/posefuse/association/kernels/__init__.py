"""Compiled parts of association; see `foundation.compiled`."""

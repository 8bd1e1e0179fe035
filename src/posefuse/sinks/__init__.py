"""Finished recordings to the files and viewers people use."""

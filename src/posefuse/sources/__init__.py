"""Video files, image folders and cameras to frames; one file per kind."""

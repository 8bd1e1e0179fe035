"""Clock offsets and drifts of unsynchronised cameras."""

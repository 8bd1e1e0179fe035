"""The command line: parses, calls the public functions, shows what they report."""

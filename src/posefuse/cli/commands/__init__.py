"""One module per command: a typed function whose signature is the options and whose docstring is the help.

They import nothing heavy, because `posefuse --help` imports them all; the work is imported inside the functions.
"""

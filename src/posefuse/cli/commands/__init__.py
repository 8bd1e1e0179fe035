"""The commands: typed functions whose signatures are the options and whose docstrings are the help.

Importing them imports nothing heavy, because `posefuse COMMAND --help` does; the work is imported inside the functions.
"""

"""Options of the commands: frozen values that the command line is made from and the functions below take.

Their annotations are evaluated at once (no ``from __future__ import annotations``): those of a base class in another file would
else be looked up in the wrong file.
"""

"""Kernel of RCE: code that several processes or clients share. Imports none of the other top-level packages."""

__version__ = "0.1.0"

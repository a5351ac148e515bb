"""Kernel of RCE: what every process and every client shares. Imports none of the other top-level packages."""

__version__ = "0.1.0"

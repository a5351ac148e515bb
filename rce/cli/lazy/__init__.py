"""Implementations of commands that need slow imports; each module is imported when its command runs.

Declarations (names, arguments, help) belong in `rce.cli.commands`, which every start of `rce` imports.
"""

"""Declarations of commands, a module for each family, joined into one table by `rce.cli.table`.

Commands that only call the HTTP API have their functions here, too. Every start of `rce` imports all of these modules:
what needs slow imports belongs in `rce.cli.lazy`.
"""

"""Extension of Griffe for mkdocs.yml: links from `Raises` sections of docstrings to the errors of `rce.errors`."""

from __future__ import annotations

from typing import Any

import griffe


class ErrorLinks(griffe.Extension):
    """Lets docstrings name the errors of `rce.errors` without importing them.

    Griffe resolves a name in the scope of its module, then in the packages above it.
    """

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Make each error known in the package `rce`."""
        errors = pkg.members.get("errors")
        if pkg.name == "rce" and isinstance(errors, griffe.Module):
            for name in errors.classes:
                pkg.members.setdefault(name, griffe.Alias(name, f"rce.errors.{name}", parent=pkg))

"""Interface packages for the tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

MANIFEST = '<?xml version="1.0"?>\n<package format="3">\n  <name>{name}</name>\n</package>\n'


def write_package(root: Path, name: str, files: Mapping[str, str]) -> Path:
    """Write a package, given the content of its files by their path; return its directory."""
    for path, text in {"package.xml": MANIFEST.format(name=name), **files}.items():
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        (root / path).write_text(text)
    return root

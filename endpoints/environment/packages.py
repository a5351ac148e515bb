"""Where the packages of ROS 2 nodes are, and the executables in them."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from rce.errors import InvalidName, NotFound

SHIPPED = Path(__file__).parents[2] / "containers" / "nodes"
"""Nodes that come with RCE; they may import `rce`."""

_PACKAGE = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_PYTHON = re.compile(rb"#! ?/\S*/python3?(\.\d+)?\s*$")
"""The first line of a program that was installed for the Python of another machine: it means the one that is here."""
_FILE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*", re.ASCII)


class Packages:
    """Packages in `prefixes` (`lib/PKG/EXE`, `share/PKG`) and, as sources with a `package.xml`, in `roots`."""

    def __init__(self, prefixes: Sequence[Path], roots: Sequence[Path]) -> None:
        self.prefixes = [path for path in (*prefixes, *roots) if (path / "share").is_dir()]
        self.sources = [path for path in (*roots, SHIPPED) if path not in self.prefixes]

    def share(self, package: str) -> Path:
        """The directory that `$(find PKG)` stands for; InvalidName, NotFound."""
        _check(_PACKAGE, package, "pkg")
        for path in [prefix / "share" / package for prefix in self.prefixes] + [
            root / package for root in self.sources
        ]:
            if (path / "package.xml").is_file():
                return path
        places = ", ".join(str(path) for path in (*self.prefixes, *self.sources))
        raise NotFound(
            f"no package {package} in this environment; looked in {places} (packages that were pushed are seen by the "
            "environments that name them, in containerData.packages)",
            field="pkg",
        )

    def command(self, package: str, executable: str) -> list[str]:
        """How to run an executable of a package; `.py` may be left out. InvalidName, NotFound."""
        _check(_FILE, executable, "exe")
        share = self.share(package)
        for directory in self._directories(package, share):
            for name in (executable, f"{executable}.py"):
                path = directory / name
                if path.is_file():
                    return _command(path)
        known = sorted({path.name for directory in self._directories(package, share) for path in _programs(directory)})
        raise NotFound(
            f"package {package} has no executable {executable}; it has {', '.join(known) or 'none'}", field="exe"
        )

    def is_shipped(self, package: str) -> bool:
        return self.share(package).is_relative_to(SHIPPED)

    def _directories(self, package: str, share: Path) -> list[Path]:
        if share.parent in self.sources:
            return [share, share / "scripts", share / "nodes", share / package]
        return [share.parents[1] / "lib" / package]


def _check(rule: re.Pattern[str], name: str, what: str) -> None:
    if not rule.fullmatch(name):
        raise InvalidName(
            f"{what} {name[:80]!r} is not a legal name of a {'package' if what == 'pkg' else 'file'}", field=what
        )


def _command(path: Path) -> list[str]:
    if path.is_relative_to(SHIPPED):  # Python, and for the one that runs this
        return [sys.executable, str(path)]
    executable = os.access(path, os.X_OK)
    with path.open("rb") as file:
        first = file.readline(256)
    if _PYTHON.match(first) or (path.suffix == ".py" and not (executable and first.startswith(b"#!"))):
        return [sys.executable, str(path)]
    if executable:
        return [str(path)]
    raise NotFound(f"{path} is not executable: make it so (chmod +x), or give it the ending .py", field="exe")


def _programs(directory: Path) -> list[Path]:
    if not directory.is_dir():
        return []
    return [
        path for path in directory.iterdir() if path.is_file() and (path.suffix == ".py" or os.access(path, os.X_OK))
    ]

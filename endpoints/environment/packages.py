"""Packages of ROS 2 nodes and their executables."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from rce.errors import InvalidName, NotFound

SHIPPED = Path(__file__).parents[2] / "containers" / "nodes"
"""Packages that come with RCE; their nodes may import `rce`."""

_PACKAGE = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_PYTHON = re.compile(rb"#! ?/\S*/python3?(\.\d+)?\s*$")
"""First line of a Python program; it may name the Python of another machine, so this machine's is used instead."""
_FILE = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*", re.ASCII)


class Packages:
    """Packages that nodes of an environment can use.

    Args:
        prefixes: Install prefixes of ROS 2, with `lib/PKG/EXE` and `share/PKG`.
        roots: More prefixes, or directories of package sources with a `package.xml`.
    """

    def __init__(self, prefixes: Sequence[Path], roots: Sequence[Path]) -> None:
        self.prefixes = [path for path in (*prefixes, *roots) if (path / "share").is_dir()]
        self.sources = [path for path in (*roots, SHIPPED) if path not in self.prefixes]

    def share(self, package: str) -> Path:
        """Return the directory of a package with its `package.xml`, which `$(find PKG)` stands for.

        Raises:
            InvalidName: The name is not valid.
            NotFound: There is no such package.
        """
        _check(_PACKAGE, package, "pkg")
        for path in [prefix / "share" / package for prefix in self.prefixes] + [
            root / package for root in self.sources
        ]:
            if (path / "package.xml").is_file():
                return path
        places = ", ".join(str(path) for path in (*self.prefixes, *self.sources))
        raise NotFound(
            f"this environment has no package {package} in {places}; a pushed package is available only if "
            "the environment was created with it (`packages` in containerData, `--package` of `rce env create`)",
            field="pkg",
        )

    def command(self, package: str, executable: str) -> list[str]:
        """Return the command that runs an executable of a package; the name may omit `.py`.

        Raises:
            InvalidName: One of the names is not valid.
            NotFound: There is no such package or executable.
        """
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
        """Return True if the package comes with RCE."""
        return self.share(package).is_relative_to(SHIPPED)

    def _directories(self, package: str, share: Path) -> list[Path]:
        if share.parent in self.sources:
            return [share, share / "scripts", share / "nodes", share / package]
        return [share.parents[1] / "lib" / package]


def _check(rule: re.Pattern[str], name: str, what: str) -> None:
    if not rule.fullmatch(name):
        raise InvalidName(
            f"{what} {name[:80]!r} is not a valid name of a {'package' if what == 'pkg' else 'file'}", field=what
        )


def _command(path: Path) -> list[str]:
    if path.is_relative_to(SHIPPED):  # written for the Python of RCE itself
        return [sys.executable, str(path)]
    executable = os.access(path, os.X_OK)
    with path.open("rb") as file:
        first = file.readline(256)
    if _PYTHON.match(first) or (path.suffix == ".py" and not (executable and first.startswith(b"#!"))):
        return [sys.executable, str(path)]
    if executable:
        return [str(path)]
    raise NotFound(f"{path} is not executable: use chmod +x, or rename it to .py", field="exe")


def _programs(directory: Path) -> list[Path]:
    if not directory.is_dir():
        return []
    return [
        path for path in directory.iterdir() if path.is_file() and (path.suffix == ".py" or os.access(path, os.X_OK))
    ]

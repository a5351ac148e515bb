"""Packages of ROS 2 nodes and their executables."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from rce.errors import InvalidName, NotFound
from rce.protocol.names import MAX_TAG
from rce.spelling import did_you_mean

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
        hint = did_you_mean(package, self.shares()) or "check its name."
        raise NotFound(
            f"this environment has no package {package} in {places}: {hint} A pushed package is available only if the "
            "environment was created with it (`packages` in containerData, `--package` of `rce env create`)",
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
        known = ", ".join(self._executables(package, share)) or "none"
        raise NotFound(f"package {package} has no executable {executable}; it has {known}", field="exe")

    def asset(self, package: str, path: str) -> Path:
        """Return a file in the directory of a package.

        Raises:
            InvalidName: The name of the package is not valid.
            NotFound: There is no such package, or no such file within it.
        """
        share = self.share(package).resolve()
        try:
            found = (share / path).resolve()
            if found.is_relative_to(share) and found.is_file():
                return found
        except (OSError, ValueError):  # a name that is too long, or has NUL in it
            pass
        raise NotFound(f"package {package} has no file {path[:200]!r}", field="path")

    def launch_file(self, package: str, name: str) -> Path:
        """Return a launch file of a package, by its name or its path in the package.

        Raises:
            InvalidName: The name of the package is not valid.
            NotFound: There is no such package or file.
        """
        share = self.share(package)
        for path in (share / "launch" / name, share / name):
            if path.is_file() and path.resolve().is_relative_to(share.resolve()):
                return path
        known = sorted(path.name for path in (share / "launch").glob("*") if path.is_file())
        hint = did_you_mean(name, known) or f"it has {', '.join(known) or 'none'}"
        raise NotFound(f"package {package} has no launch file {name[:200]}: {hint}", field="launch")

    def shares(self) -> dict[str, Path]:
        """Return the directory of each package; of several with one name, that of the first place."""
        files = [file for prefix in self.prefixes for file in (prefix / "share").glob("*/package.xml")]
        files += [file for root in self.sources for file in root.glob("*/package.xml")]
        return {file.parent.name: file.parent for file in reversed(files)}

    def executables(self) -> dict[str, list[str]]:
        """Return the names of executables by package, both sorted; packages without any are left out."""
        found = {name: self._executables(name, share) for name, share in sorted(self.shares().items())}
        return {name: executables for name, executables in found.items() if executables}

    def is_shipped(self, package: str) -> bool:
        """Return True if the package comes with RCE."""
        return self.share(package).is_relative_to(SHIPPED)

    def _executables(self, package: str, share: Path) -> list[str]:
        return sorted({path.name for directory in self._directories(package, share) for path in _programs(directory)})

    def _directories(self, package: str, share: Path) -> list[Path]:
        if share.parent in self.sources:
            return [share, share / "scripts", share / "nodes", share / package]
        return [share.parents[1] / "lib" / package]


def _check(rule: re.Pattern[str], name: str, what: str) -> None:
    if len(name) > MAX_TAG or not rule.fullmatch(name):
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
    """Return the programs in a directory. Python files elsewhere than in `scripts` and `nodes` may be modules."""
    if not directory.is_dir():
        return []
    python = directory.name in ("scripts", "nodes")
    return [
        path
        for path in directory.iterdir()
        if path.is_file() and (os.access(path, os.X_OK) or (python and path.suffix == ".py"))
    ]

"""Locations of ROS 2: the wheels in this Python's prefix, or a system ROS 2 in `AMENT_PREFIX_PATH`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from rce.errors import NotFound

MARKER = "rce-typesupport"
"""File that marks a prefix which `provisioning.typesupport` built, so that it is not read as input."""


def prefixes() -> list[Path]:
    """Return the prefixes with ROS 2 packages, those of `AMENT_PREFIX_PATH` first."""
    listed = [Path(path) for path in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]
    return [
        path
        for path in dict.fromkeys([*listed, Path(sys.prefix)])
        if (path / "share" / "ament_index").is_dir() and not (path / MARKER).exists()
    ]


def share(package: str) -> Path | None:
    """Return the share directory of a package, or None if it is not installed."""
    for prefix in prefixes():
        if (directory := prefix / "share" / package).is_dir():
            return directory
    return None


def required(package: str) -> Path:
    """Return the share directory of a package that type support cannot be built without.

    Raises:
        NotFound: The package is not installed.
    """
    directory = share(package)
    if directory is None:
        raise NotFound(
            f"ROS 2 package {package} is not installed in {sys.prefix}: pip install '.[ros]' in a checkout of RCE"
        )
    return directory


def interface_packages() -> dict[str, Path]:
    """Return the share directories of all installed packages that define messages or services, by name."""
    found: dict[str, Path] = {}
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "rosidl_interfaces"
        for resource in sorted(index.glob("*")):
            found.setdefault(resource.name, prefix / "share" / resource.name)
    return found


def include_directories() -> list[Path]:
    """Return the include path of C and C++ code that uses installed packages."""
    found = []
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "packages"
        found += [prefix / "include" / resource.name for resource in sorted(index.glob("*"))]
        found.append(prefix / "include")  # the headers of Fast CDR
    return [directory for directory in found if directory.is_dir()]

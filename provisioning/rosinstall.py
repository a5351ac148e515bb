"""Where ROS 2 is installed: the wheels in this Python's prefix, or a system ROS 2 that `AMENT_PREFIX_PATH` names."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from rce.errors import NotFound

MARKER = "rce-typesupport"
"""File in a prefix that `provisioning.typesupport` built. Those are its output, never its input."""


def prefixes() -> list[Path]:
    """Prefixes with ROS 2 packages, those of `AMENT_PREFIX_PATH` first."""
    listed = [Path(path) for path in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if path]
    return [
        path
        for path in dict.fromkeys([*listed, Path(sys.prefix)])
        if (path / "share" / "ament_index").is_dir() and not (path / MARKER).exists()
    ]


def share(package: str) -> Path | None:
    """The share directory of a package, None if it is not installed."""
    for prefix in prefixes():
        if (directory := prefix / "share" / package).is_dir():
            return directory
    return None


def required(package: str) -> Path:
    """The share directory of a package that type support cannot be built without; raises NotFound."""
    directory = share(package)
    if directory is None:
        raise NotFound(
            f"ROS 2 package {package} is not installed in {sys.prefix}: pip install '.[ros]' in a checkout of RCE"
        )
    return directory


def interface_packages() -> dict[str, Path]:
    """The share directories of all installed packages that define messages or services."""
    found: dict[str, Path] = {}
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "rosidl_interfaces"
        for resource in sorted(index.glob("*")):
            found.setdefault(resource.name, prefix / "share" / resource.name)
    return found


def include_directories() -> list[Path]:
    """What C and C++ code that uses installed packages needs on its include path."""
    found = []
    for prefix in prefixes():
        index = prefix / "share" / "ament_index" / "resource_index" / "packages"
        found += [prefix / "include" / resource.name for resource in sorted(index.glob("*"))]
        found.append(prefix / "include")  # Fast CDR's headers are not in a directory of their own
    return [directory for directory in found if directory.is_dir()]

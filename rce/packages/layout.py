"""Selection of the files of a directory that make up its ROS packages, and checks that they run without a build."""

from __future__ import annotations

import os
import platform
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from msgspec import Struct

from rce.errors import InvalidRequest, NotFound
from rce.packages.archive import Entry

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}-{platform.machine()}"
"""Directory of an archive with the type support that was built for this version of Python and architecture."""

INSTALLED = ("share", "lib", "local", "python")  # of an install prefix; headers and set-up scripts are not needed
NEED_BUILD = ("setup.py", "setup.cfg", "pyproject.toml", "Cargo.toml")
INTERFACES = ("msg", "srv", "action")  # directories of definitions, and the endings of their files
COMPILED = frozenset({".c", ".cc", ".cpp", ".cxx", ".pyx", ".rs"})
EXCLUDED = frozenset({"__pycache__", "node_modules"})
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)


class Layout(Struct, frozen=True):
    """Files to push from a directory.

    Attributes:
        name: Default name of the package.
        entries: Files of the archive.
        interfaces: Directories of source packages with messages or services, which need type support.
    """

    name: str
    entries: list[Entry]
    interfaces: list[Path] = []


def read(directory: Path, as_is: bool = False) -> Layout:
    """Collect the files of a directory.

    The directory is a source package, has source packages as subdirectories, or is an install space of colcon (merged
    or isolated).

    Args:
        directory: Directory to push.
        as_is: Accept sources that need a build.

    Raises:
        NotFound: There is no ROS package.
        InvalidRequest: A package must be built before it can run, or has links that cannot be packed.
    """
    directory = directory.expanduser().resolve()
    if not directory.is_dir():
        raise NotFound(f"{directory} is not a directory")
    if (directory / "package.xml").is_file():
        return _sources(_package_name(directory), [directory], as_is)
    children = sorted(path for path in directory.iterdir() if path.is_dir() and not path.name.startswith("."))
    prefixes = [path for path in (directory, *children) if any(path.glob("share/*/package.xml"))]
    if prefixes:
        return Layout(_name_of(directory), _merged(prefixes))
    packages = [path for path in children if (path / "package.xml").is_file()]
    if packages:
        return _sources(_name_of(directory), packages, as_is)
    built = f"; to push the built workspace, push {directory / 'install'}" if (directory / "install").is_dir() else ""
    raise NotFound(
        f"{directory} contains no ROS package: no package.xml, no subdirectory with one, and no share/PKG{built}"
    )


def _sources(name: str, packages: list[Path], as_is: bool) -> Layout:
    entries: list[Entry] = []
    for package in packages:
        own = _package_name(package)
        files = list(_files(package))
        if not as_is:
            _check_runs(package, files)
        entries += [_entry(f"{own}/{path.relative_to(package).as_posix()}", path) for path in files]
    interfaces = [path for path in packages if any(any(path.glob(f"{kind}/*.{kind}")) for kind in INTERFACES)]
    return Layout(name, entries, interfaces)


def _check_runs(package: Path, files: list[Path]) -> None:
    sources = [path for path in files if path.suffix in COMPILED]
    named = [path for name in NEED_BUILD if (path := package / name) in files]
    for found in (*named, *sources):
        raise InvalidRequest(
            f"{package.name} contains {found.relative_to(package)}, so it must be built before it can run: "
            f"make an image with `rce image build {package}`, or build it and push its install space, "
            "or push the directory unchanged with --as-is"
        )


def _merged(prefixes: list[Path]) -> list[Entry]:
    """Merge the files of several install prefixes into one."""
    found: dict[str, Path] = {}
    for prefix in prefixes:
        for top in INSTALLED:
            for path in _files(prefix / top):
                name = path.relative_to(prefix).as_posix()
                other = found.setdefault(name, path)
                if other != path and other.read_bytes() != path.read_bytes():
                    raise InvalidRequest(f"{other} and {path} differ, but an archive can have only one of them")
    return [_entry(name, path) for name, path in found.items()]


def copy_interfaces(package: Path, directory: Path) -> Path:
    """Copy only the files on which type support depends, so that it is rebuilt only when they change."""
    copy = directory / _package_name(package)
    copy.mkdir()
    shutil.copy(package / "package.xml", copy)
    for kind in INTERFACES:
        if (package / kind).is_dir():
            shutil.copytree(package / kind, copy / kind)
    return copy


def type_support(prefix: Path, interfaces: list[Path]) -> list[Entry]:
    """Return the type support of source packages and of the packages that their messages use.

    Args:
        prefix: Directory into which provisioning has built type support.
        interfaces: Directories of the source packages.
    """
    own = {_package_name(path) for path in interfaces}
    texts = "\n".join(path.read_text() for root in interfaces for path in root.glob("[ms][sr][gv]/*.[ms][sr][gv]"))
    used = {path.name for path in (prefix / "python").iterdir() if re.search(rf"\b{re.escape(path.name)}/", texts)}
    entries = []
    for name in sorted(own | used):
        built = prefix / "python" / name
        entries += [_entry(f"{PYTHON}/{name}/{path.relative_to(built).as_posix()}", path) for path in _files(built)]
    return entries


def _files(directory: Path) -> Iterator[Path]:
    """Yield the files except hidden and compiled ones; raises InvalidRequest for links to directories or outside."""
    inside = directory.resolve()
    for root, folders, names in os.walk(directory):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in EXCLUDED)
        for name in sorted(names):
            path = Path(root, name)
            if name.startswith(".") or path.suffix == ".pyc":
                continue
            if not path.resolve().is_relative_to(inside):
                raise InvalidRequest(
                    f"{path} is a link to a file outside of {directory}: build without --symlink-install"
                )
            if path.is_file():
                yield path
        for name in folders:
            if Path(root, name).is_symlink():
                raise InvalidRequest(f"{Path(root, name)} is a link to a directory: copy it instead")


def _entry(name: str, path: Path) -> Entry:
    return Entry(name, path, os.access(path, os.X_OK))


def _package_name(directory: Path) -> str:
    """Return the name in `package.xml`; raises InvalidRequest."""
    try:
        name = (ElementTree.parse(directory / "package.xml").getroot().findtext("name") or "").strip()
    except ElementTree.ParseError as error:
        raise InvalidRequest(f"{directory / 'package.xml'}: {error}") from None
    if not _NAME.fullmatch(name):
        raise InvalidRequest(f"{directory / 'package.xml'} has no valid <name>: {name[:80]!r}")
    return name


def _name_of(directory: Path) -> str:
    """Return the default name of a package: the directory's, or for a colcon `install` directory its parent's."""
    return directory.parent.name if directory.name == "install" else directory.name

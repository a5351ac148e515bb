"""Reader of ROS 2 interface packages: `package.xml`, `msg/*.msg`, `srv/*.srv` and `action/*.action`.

Errors are reported with file and line before any code is generated.
"""

from __future__ import annotations

import contextlib
import io
import keyword
import re
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from provisioning import rosinstall
from rce.errors import AlreadyExists, InvalidName, InvalidRequest, NotFound, UnknownType

try:
    from rosidl_adapter import parser
except ModuleNotFoundError as error:
    raise NotFound("ROS 2 is not installed in this Python: pip install '.[ros]' in a checkout of RCE") from error

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
# ROS 1 allowed capital letters in names of packages and fields, and its messages are still in use (`Test/StringEcho`,
# `testType`). The generators support them, so the rule of the adapter is relaxed.
parser.VALID_PACKAGE_NAME_PATTERN = parser.VALID_FIELD_NAME_PATTERN = NAME  # type: ignore[misc]
# The exceptions that the adapter raises for malformed lines.
parser_errors = (
    *(parser.InvalidSpecification, parser.InvalidValue),
    *(ValueError, TypeError, NameError, IndexError, NotImplementedError),
)

SEPARATORS = {
    ".srv": (1, "a service has one line --- between request and response"),
    ".action": (2, "an action has two lines --- between goal, result and feedback"),
}
"""Number of lines that separate the sections of a file, and the rule for them."""


class Reference(NamedTuple):
    """A message type that a definition uses."""

    package: str
    name: str


@dataclass(frozen=True)
class Interface:
    """A message, service or action.

    Attributes:
        path: File, relative to the package.
        references: Messages that it contains, with the lines of their first use.
    """

    path: Path
    references: dict[Reference, int]


@dataclass(frozen=True)
class Package:
    """An interface package.

    Attributes:
        name: Name in package.xml.
        root: Directory of the package.
        interfaces: Messages, services and actions.
        left_out: Files that are not supported: IDL.
    """

    name: str
    root: Path
    interfaces: tuple[Interface, ...]
    left_out: tuple[Path, ...]

    @property
    def uses(self) -> frozenset[Reference]:
        """Messages of other packages that this one contains."""
        references = (reference for interface in self.interfaces for reference in interface.references)
        return frozenset(reference for reference in references if reference.package != self.name)

    @property
    def files(self) -> list[Path]:
        """Files that a build of the package depends on, in a fixed order."""
        definitions = [self.root / interface.path for interface in self.interfaces]
        return [self.root / "package.xml", *definitions, *self.scripts]

    @property
    def scripts(self) -> list[Path]:
        """Nodes in the package."""
        return sorted(path for path in (self.root / "scripts").glob("*") if path.is_file())


def read_packages(roots: Iterable[Path]) -> list[Package]:
    """Read the packages in these directories and return them with dependencies first.

    Raises:
        InvalidRequest: A file is malformed, or packages depend on each other.
        InvalidName: The name of a package or type is not legal.
        UnknownType: A message is defined neither in these packages nor in installed ones.
        AlreadyExists: A name is used twice.
    """
    packages: dict[str, Package] = {}
    for package in map(read_package, roots):
        check_package_name(package, packages)
        packages[package.name] = package
    for package in packages.values():
        check_references(package, packages)
    return in_order(packages)


def read_package(root: Path) -> Package:
    """Read the package in a directory. Raises the same as `read_packages`."""
    name = package_name(root / "package.xml")
    found = sorted([*root.glob("msg/*.msg"), *root.glob("srv/*.srv"), *root.glob("action/*.action")])
    if not found:
        raise InvalidRequest(f"{root} has neither msg/*.msg nor srv/*.srv nor action/*.action")
    check_file_names(found)
    interfaces = tuple(Interface(path.relative_to(root), read_definition(path, name)) for path in found)
    return Package(name, root, interfaces, tuple(sorted(root.glob("*/*.idl"))))


def package_name(manifest: Path) -> str:
    """Return the name in a package.xml.

    Raises:
        InvalidRequest: The file is missing or malformed.
        InvalidName: The name is not legal.
    """
    try:
        name = ElementTree.parse(manifest).findtext("name", "").strip()
    except FileNotFoundError:
        raise InvalidRequest(f"{manifest} does not exist, so {manifest.parent} is not a ROS 2 package") from None
    except ElementTree.ParseError as error:
        raise InvalidRequest(f"{manifest}:{error.position[0]}: {error}") from None
    if not NAME.fullmatch(name) or "__" in name or name.endswith("_") or keyword.iskeyword(name):
        raise InvalidName(
            f"{manifest}: {name!r} is not a legal package name: letters, digits and single _ between them"
        )
    return name


def check_package_name(package: Package, others: dict[str, Package]) -> None:
    """Check that no other package or Python module has this name.

    Case is ignored: generated code becomes a Python package, with directories in lower case.

    Raises:
        AlreadyExists: The name is in use.
    """
    for other in others.values():
        if other.name.lower() == package.name.lower():
            raise AlreadyExists(f"{package.root} and {other.root} are both packages of the name {package.name}")
    module = Path(sysconfig.get_path("purelib"), package.name)
    taken = rosinstall.share(package.name) or next(
        (path for path in (module, module.with_suffix(".py")) if path.exists()), None
    )
    if taken or package.name in sys.stdlib_module_names:
        where = taken or "Python's standard library"
        raise AlreadyExists(f"{package.root / 'package.xml'}: the name {package.name} is used by {where}")


def check_file_names(paths: Sequence[Path]) -> None:
    """Check the file names of types, which must also differ in lower case, as generated files have it.

    Raises:
        InvalidName: A name is not a legal type name.
        AlreadyExists: Two names differ in case only.
    """
    seen: dict[tuple[str, str], Path] = {}
    for path in paths:
        if not parser.is_valid_message_name(path.stem):
            raise InvalidName(
                f"{path}: {path.stem!r} is not a legal type name: a capital letter, then letters and digits"
            )
        other = seen.setdefault((path.parent.name, path.stem.lower()), path)
        if other is not path:
            raise AlreadyExists(f"{path} and {other.name} differ in case only")


def read_definition(path: Path, package: str) -> dict[Reference, int]:
    """Check a `.msg`, `.srv` or `.action` file, and return the messages that it uses with the lines of their first use.

    Raises:
        InvalidRequest: A line is malformed. The message has its number.
    """
    sections: list[set[str]] = [set()]
    references: dict[Reference, int] = {}
    for number, line in numbered_lines(path):
        if path.suffix in SEPARATORS and line == "---":
            sections.append(set())
        else:
            used = read_line(line, package, sections[-1], f"{path}:{number}")
            references |= dict.fromkeys(used - references.keys(), number)
    wanted, rule = SEPARATORS.get(path.suffix, (0, ""))
    if len(sections) - 1 != wanted:
        raise InvalidRequest(f"{path}: {rule}, not {len(sections) - 1}")
    return references


def read_line(line: str, package: str, names: set[str], where: str) -> set[Reference]:
    """Return the messages that a line uses, and add the names that it declares to `names`."""
    message = parse_line(line, package, where)
    for name in [field.name for field in message.fields] + [constant.name for constant in message.constants]:
        if name in names:
            raise InvalidRequest(f"{where}: {name} is declared twice")
        if keyword.iskeyword(name):
            raise InvalidRequest(f"{where}: a field cannot be called {name}, a keyword of Python")
        names.add(name)
    types = [field.type for field in message.fields if not field.type.is_primitive_type()]
    return {Reference(str(kind.pkg_name), kind.type) for kind in types}


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Return the lines of a file with their numbers from 1."""
    try:
        return enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
    except UnicodeDecodeError as error:
        raise InvalidRequest(f"{path}: not UTF-8: {error}") from None


def parse_line(line: str, package: str, where: str) -> parser.MessageSpecification:
    """Parse one line as a message of its own, so that an error is attributed to the line."""
    with contextlib.redirect_stderr(io.StringIO()):  # the adapter also prints what it raises
        try:
            return parser.parse_message_string(package, "Line", line)
        except parser_errors as error:
            raise InvalidRequest(f"{where}: {line.strip()!r} is not a field or constant: {error}") from None


def check_references(package: Package, given: dict[str, Package]) -> None:
    """Check that all messages that a package uses are defined.

    Raises:
        UnknownType: One is not. The message has file and line.
    """
    for interface in package.interfaces:
        for reference, number in interface.references.items():
            if not is_defined(reference, given):
                where = f"{package.root / interface.path}:{number}"
                name = f"{reference.package}/{reference.name}"
                raise UnknownType(f"{where}: {name} is neither installed nor among the packages to build")


def is_defined(reference: Reference, given: dict[str, Package]) -> bool:
    """Return True if one of the given packages or an installed one defines this message."""
    file = Path("msg", f"{reference.name}.msg")
    if package := given.get(reference.package):
        return any(interface.path == file for interface in package.interfaces)
    directory = rosinstall.share(reference.package)
    return directory is not None and (directory / file).exists()


def in_order(packages: dict[str, Package]) -> list[Package]:
    """Return the packages with dependencies first.

    Raises:
        InvalidRequest: Packages depend on each other.
    """
    graph = {
        name: sorted({reference.package for reference in package.uses} & packages.keys())
        for name, package in sorted(packages.items())
    }
    try:
        return [packages[name] for name in TopologicalSorter(graph).static_order()]
    except CycleError as error:
        raise InvalidRequest(f"packages depend on each other: {' → '.join(error.args[1])}") from None

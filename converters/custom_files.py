"""Finds and loads converters of users: from Python files, and from installed packages.

An installed package names its converters in the entry points of the group `rce.converters`.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Iterator
from importlib import metadata
from importlib.util import module_from_spec, spec_from_file_location
from inspect import isabstract
from pathlib import Path
from types import ModuleType
from typing import NoReturn

from msgspec import Struct

from converters.custom import Converter
from converters.ros1 import ROS1
from rce.errors import InvalidName, InvalidRequest, StartFailed
from rce.protocol.names import parse_type

GROUP = "rce.converters"
RESERVED = {"png", "jpeg", "json", "cdr", ROS1}
NAME = re.compile(r"[a-z][a-z0-9_-]{0,39}")


class Description(Struct, frozen=True):
    """A converter without its code: its name, the full name of its type, and whether it is its type's default."""

    name: str
    type: str
    default: bool


def wanted(path: str) -> bool:
    """Return True if there may be converters: `path` is given, or an installed package has some."""
    return bool(path or metadata.entry_points(group=GROUP))


def load(path: str) -> dict[str, Converter]:
    """Return the converters of a file, or of the files of a directory, and of installed packages, by name.

    Args:
        path: Python file, or directory with Python files; empty for installed packages only.

    Raises:
        StartFailed: A converter cannot be loaded; the message has file, line and remedy.
    """
    found: dict[str, Converter] = {}
    places: dict[str, str] = {}
    for place, kind in [*_of_path(path), *_of_packages()]:
        converter = _instance(kind, place)
        for other in found.values():
            if other.name == converter.name:
                _fail(place, f"the name {converter.name!r} is that of the converter of {places[other.name]} too")
            same = parse_type(other.type) == parse_type(converter.type)
            if same and other.default and converter.default:
                _fail(place, f"{converter.type} has a default converter in {places[other.name]} too")
        found[converter.name], places[converter.name] = converter, place
    return found


def describe(converters: dict[str, Converter]) -> list[Description]:
    """Return the descriptions of converters."""
    return [Description(each.name, parse_type(each.type).msg, each.default) for each in converters.values()]


def _of_path(path: str) -> Iterator[tuple[str, type[Converter]]]:
    """Yield the converters of a file or directory, each with its place."""
    if not path:
        return
    place = Path(path).expanduser()
    files = sorted(place.glob("*.py")) if place.is_dir() else [place]
    if not place.exists():
        _fail(str(place), "there is no such file or directory: correct --converters")
    if not files:
        _fail(str(place), "the directory has no Python file: correct --converters")
    for file in files:
        module = _module(file)
        own = [each for each in vars(module).values() if _is_converter(each) and each.__module__ == module.__name__]
        if not own and not place.is_dir():
            _fail(str(file), "it has no subclass of converters.Converter: add one, or correct --converters")
        for kind in own:
            yield f"{file}, class {kind.__name__}", kind


def _module(file: Path) -> ModuleType:
    name = f"rce_converters_{re.sub(r'[^A-Za-z0-9_]', '_', file.stem)}"
    spec = spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        _fail(str(file), "this is not a Python file (*.py)")
    module = sys.modules[name] = module_from_spec(spec)  # where dataclasses and pickle look for it
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # noqa: BLE001  # whatever it is, the file is at fault
        _fail_with(str(file), error, str(file))
    return module


def _of_packages() -> Iterator[tuple[str, type[Converter]]]:
    """Yield the converters of installed packages, each with its place."""
    for point in metadata.entry_points(group=GROUP):
        place = f"package {point.dist.name if point.dist else '?'}, {point.value}"
        try:
            kind = point.load()
        except Exception as error:  # noqa: BLE001  # whatever it is, the package is at fault
            _fail_with(place, error)
        if not _is_converter(kind):
            _fail(place, f"{point.name!r} of the group {GROUP} must be a subclass of converters.Converter")
        yield place, kind


def _is_converter(value: object) -> bool:
    return isinstance(value, type) and issubclass(value, Converter) and value is not Converter


def _instance(kind: type[Converter], place: str) -> Converter:
    if isabstract(kind):
        _fail(place, f"it lacks {', '.join(sorted(kind.__abstractmethods__))}")
    name = getattr(kind, "name", None)
    if not isinstance(name, str) or not NAME.fullmatch(name):
        _fail(place, "it needs a `name`, such as name = 'cloud': lower-case letters, digits, _ and -, at most 40")
    if name in RESERVED:
        _fail(place, f"{name!r} is the name of a format of the platform: choose another")
    type_name = getattr(kind, "type", None)
    try:
        parse_type(type_name if isinstance(type_name, str) else "")
    except (InvalidName, InvalidRequest):
        _fail(place, "it needs the `type` of its messages, such as type = 'sensor_msgs/PointCloud2'")
    try:
        return kind()
    except Exception as error:  # noqa: BLE001  # whatever it is, the class is at fault
        _fail_with(place, error)


def _fail_with(place: str, error: Exception, file: str = "") -> NoReturn:
    """Fail with the line of the user's code that an exception comes from: of `file`, or the last one."""
    if isinstance(error, SyntaxError):
        where, reason = f"{error.filename}, line {error.lineno}", f"{error.msg}"
    else:
        frames = [each for each in traceback.extract_tb(error.__traceback__) if "importlib" not in each.filename]
        own = [each for each in frames if each.filename == file] or [
            each for each in frames if each.filename != __file__
        ]
        last = own[-1] if own else None
        where = f"{last.filename}, line {last.lineno}" if last else place
        reason = str(error)[:300]
    _fail(where, f"{type(error).__name__}: {reason}: correct it, or start without this converter")


def _fail(place: str, reason: str) -> NoReturn:
    raise StartFailed(f"converters: {place}: {reason}")

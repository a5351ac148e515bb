"""Texts of the installed definitions of messages, services and actions, with all definitions that they use."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from rce.control.calls.robots import Sort
from rce.errors import UnknownType
from rce.protocol.names import TYPE, parse_type

_FIELD = re.compile(r"\s*([A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z0-9_]+){0,2})(?:<=\d+)?(?:\[(?:<=)?\d*\])?\s+[a-zA-Z]")
_BUILT_IN = frozenset(
    [
        "bool",
        "byte",
        "char",
        "string",
        "wstring",
        "float32",
        "float64",
        "int8",
        "uint8",
        "int16",
        "uint16",
        "int32",
        "uint32",
        "int64",
        "uint64",
    ]
)
SORTS: dict[Sort, str] = {"msg": "message", "srv": "service", "action": "action"}


class InstalledTypes:
    """Installed types.

    Args:
        prefixes: Install prefixes of ROS 2, with definitions in `share/PKG/msg`.
        sources: Directories of package sources, with definitions in `PKG/msg`.
    """

    def __init__(self, prefixes: Sequence[Path], sources: Sequence[Path] = ()) -> None:
        self._places = [prefix / "share" for prefix in prefixes] + list(sources)

    def find(self, package: str, sort: Sort, name: str) -> Path:
        """Return the file that defines a type; raise UnknownType if it is not installed."""
        for place in self._places:
            path = place / package / sort / f"{name}.{sort}"
            if path.is_file():
                return path
        raise UnknownType(
            f"this environment has no {SORTS[sort]} type {package}/{name}: check the spelling, or install its package",
            field="className",
        )

    def describe(self, name: str, sort: Sort) -> dict[str, str]:
        """Return the definitions of a type and of all types that it uses, by `pkg/SORT/Name`.

        Raises:
            UnknownType: One of the types is not installed.
        """
        package, base = parse_type(name)
        wanted: list[tuple[str, Sort, str]] = [(package, sort, base)]
        texts: dict[str, str] = {}
        while wanted:
            package, sort, base = wanted.pop()
            key = f"{package}/{sort}/{base}"
            if key not in texts:
                texts[key] = self.find(package, sort, base).read_text()
                wanted += [(used_package, "msg", used) for used_package, used in _used(texts[key], package)]
        return texts


def _used(text: str, package: str) -> Iterable[tuple[str, str]]:
    """Yield package and name of every message type that the fields of a definition use."""
    for line in text.splitlines():
        field = _FIELD.match(line.partition("#")[0])
        if field is None or field[1] in _BUILT_IN:
            continue
        full = TYPE.fullmatch(field[1])
        yield (full[1], full[3]) if full else (("std_msgs", "Header") if field[1] == "Header" else (package, field[1]))

"""The naming rules of the wire: tags, message types, interface tags with their endpoint."""

from __future__ import annotations

import re
from typing import NamedTuple

from rce.errors import InvalidName, InvalidRequest

TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
TYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/(?:(msg|srv)/)?([A-Za-z][A-Za-z0-9_]*)", re.ASCII)
MAX_TAG = 255  # the original has no cap; a tag is also a file name here, and those end at 255 bytes


def check_tag(tag: str, what: str) -> str:
    """Return `tag` if it follows the rule for userID, robotID and all tags; `what` names it in the error."""
    if not TAG.fullmatch(tag) or len(tag) > MAX_TAG:
        raise InvalidName(
            f"{what} {tag[:80]!r} is not a legal name: an ASCII letter, then ASCII letters, digits or _ "
            f"({MAX_TAG} at most)",
            field=what,
        )
    return tag


class TypeName(NamedTuple):
    """A ROS message or service type without the part that spellings differ in: `pkg/Name`."""

    package: str
    name: str

    def __str__(self) -> str:
        return f"{self.package}/{self.name}"

    @property
    def msg(self) -> str:
        return f"{self.package}/msg/{self.name}"

    @property
    def srv(self) -> str:
        return f"{self.package}/srv/{self.name}"


def parse_type(text: str) -> TypeName:
    """`pkg/Name`, `pkg/msg/Name` and `pkg/srv/Name` name the same type."""
    match = TYPE.fullmatch(text)
    if not match:
        raise InvalidRequest(f"className {text[:80]!r} is not a ROS type: write it as pkg/Name", field="className")
    return TypeName(match[1], match[3])


def split_interface(text: str, what: str) -> tuple[str, str]:
    """`endpointTag/interfaceTag` in its two parts; `what` names the key in the error."""
    endpoint, slash, interface = text.partition("/")
    if not slash:
        raise InvalidRequest(f"{what} {text[:80]!r} is not of the form endpointTag/interfaceTag", field=what)
    check_tag(endpoint, f"{what} (endpointTag)")
    check_tag(interface, f"{what} (interfaceTag)")
    return endpoint, interface

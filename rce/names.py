"""The naming rules of the wire: tags, names of guests, message types, interface tags with their endpoint."""

from __future__ import annotations

import re
from typing import NamedTuple

from rce.errors import InvalidName, InvalidRequest

TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
TYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/(?:(msg|srv)/)?([A-Za-z][A-Za-z0-9_]*)", re.ASCII)
MAX_TAG = 255  # the original has no cap; a tag is also a file name here, and those end at 255 bytes
GUEST = "@"
"""Begins the robotID of a guest (`@console`), and the names of what it makes (`@console.shell`): nobody else's may."""


def check_tag(tag: str, what: str) -> str:
    """Return `tag` if it follows the rule for userID, robotID and all tags; `what` names it in the error."""
    if not TAG.fullmatch(tag) or len(tag) > MAX_TAG:
        raise InvalidName(
            f"{what} {tag[:80]!r} is not a legal name: an ASCII letter, then ASCII letters, digits or _ "
            f"({MAX_TAG} at most)",
            field=what,
        )
    return tag


def is_guest(tag: str) -> bool:
    """Whether this is the robotID of a guest."""
    return tag.startswith(GUEST)


def check_robot(tag: str, what: str) -> str:
    """As `check_tag`, for a robotID: that of a guest is a tag after its `@`."""
    check_tag(tag.removeprefix(GUEST), what)
    return tag


def check_made(tag: str, what: str, guest: str = "") -> str:
    """As `check_tag`, for the name of something new; `guest` is the robotID of who makes it, if that is a guest."""
    check_tag(tag.removeprefix(f"{guest}.") if guest else tag, what)
    return tag


def _check_any(tag: str, what: str) -> None:
    """A name of something that is there, whoever made it."""
    if is_guest(tag):
        guest, dot, rest = tag.partition(".")
        check_tag(guest.removeprefix(GUEST), what)
        if not dot:
            return
        tag = rest
    check_tag(tag, what)


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
    _check_any(endpoint, f"{what} (endpointTag)")
    _check_any(interface, f"{what} (interfaceTag)")
    return endpoint, interface

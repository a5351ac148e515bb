"""Naming rules of the protocol: tags, names of guests, message types, and interface tags with their endpoint."""

from __future__ import annotations

import re
from typing import Annotated, NamedTuple

from msgspec import Meta

from rce.errors import InvalidName, InvalidRequest

TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
TYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/(?:(msg|srv|action)/)?([A-Za-z][A-Za-z0-9_]*)", re.ASCII)
MAX_TAG = 255  # the original has no limit; here a tag is also a file name, which may have 255 bytes
GUEST_PREFIX = "@"
"""Prefix of the robotID of a guest (`@console`) and of the names that it gives (`@console.shell`), and of no others."""

# The functions below check names where they are used, for better errors; these patterns are for JSON Schema.
Text = Annotated[str, Meta(min_length=1)]
Tag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}$", "maxLength": MAX_TAG})]
TagOrNone = Annotated[str, Meta(extra_json_schema={"pattern": f"^({TAG.pattern})?$", "maxLength": MAX_TAG})]
InterfaceTag = Annotated[str, Meta(extra_json_schema={"pattern": f"^{TAG.pattern}/{TAG.pattern}$"})]
TypeText = Annotated[str, Meta(max_length=MAX_TAG, extra_json_schema={"pattern": f"^{TYPE.pattern}$"})]


def check_tag(tag: str, what: str) -> str:
    """Check a userID, robotID or other tag and return it.

    Args:
        tag: The tag.
        what: Name of the field, for the error.

    Raises:
        InvalidName: The tag breaks the naming rule.
    """
    if not TAG.fullmatch(tag) or len(tag) > MAX_TAG:
        raise InvalidName(
            f"{what} {tag[:80]!r} is not a legal name: an ASCII letter, then ASCII letters, digits or _ "
            f"(at most {MAX_TAG} characters)",
            field=what,
        )
    return tag


def is_guest(tag: str) -> bool:
    """Return True if `tag` is the robotID of a guest, or a name that a guest gave."""
    return tag.startswith(GUEST_PREFIX)


def check_robot_id(tag: str, what: str) -> str:
    """Check a robotID like `check_tag`; that of a guest is `@` and a tag."""
    check_tag(tag.removeprefix(GUEST_PREFIX), what)
    return tag


def check_new_name(tag: str, what: str, guest: str = "") -> str:
    """Check the name of a new object like `check_tag`.

    If a guest creates the object, `guest` is its robotID; the name may then begin with `guest` and a dot.
    """
    check_tag(tag.removeprefix(f"{guest}.") if guest else tag, what)
    return tag


def _check_any(tag: str, what: str) -> None:
    """Check the name of an existing object, which a guest may have created."""
    if is_guest(tag):
        guest, dot, rest = tag.partition(".")
        check_tag(guest.removeprefix(GUEST_PREFIX), what)
        if not dot:
            return
        tag = rest
    check_tag(tag, what)


class TypeName(NamedTuple):
    """Name of a ROS message, service or action type, independent of its spelling."""

    package: str
    name: str

    def __str__(self) -> str:
        return f"{self.package}/{self.name}"

    @property
    def msg(self) -> str:
        """The name as `pkg/msg/Name`."""
        return f"{self.package}/msg/{self.name}"

    @property
    def srv(self) -> str:
        """The name as `pkg/srv/Name`."""
        return f"{self.package}/srv/{self.name}"

    @property
    def action(self) -> str:
        """The name as `pkg/action/Name`."""
        return f"{self.package}/action/{self.name}"


def parse_type(text: str) -> TypeName:
    """Parse the name of a type; `pkg/Name`, `pkg/msg/Name`, `pkg/srv/Name` and `pkg/action/Name` are equal.

    Raises:
        InvalidRequest: The text is not the name of a type.
    """
    match = TYPE.fullmatch(text) if len(text) <= MAX_TAG else None
    if not match:
        raise InvalidRequest(f"className {text[:80]!r} is not a ROS type: write it as pkg/Name", field="className")
    return TypeName(match[1], match[3])


def split_interface(text: str, what: str) -> tuple[str, str]:
    """Split `endpointTag/interfaceTag` into its two parts.

    Args:
        text: The text to split.
        what: Name of the field, for the error.

    Raises:
        InvalidRequest: The text does not have this form.
        InvalidName: One of the tags breaks the naming rule.
    """
    endpoint, slash, interface = text.partition("/")
    if not slash:
        raise InvalidRequest(f"{what} {text[:80]!r} is not of the form endpointTag/interfaceTag", field=what)
    _check_any(endpoint, f"{what} (endpointTag)")
    _check_any(interface, f"{what} (interfaceTag)")
    return endpoint, interface

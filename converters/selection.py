"""Selection of some fields of a message type: readers of the selected type skip all others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from converters.model import IMAGE, Message
from converters.scalars import join
from rce.errors import InvalidRequest
from rce.spelling import did_you_mean

Tree = dict[str, "Tree"]
"""Wanted fields by name, each with those wanted inside it; without any, the field is wanted as a whole."""


def select(message: Message, fields: Iterable[str], *, pictures: bool = False) -> Message:
    """Return a message type with the same layout, of which only some fields are wanted.

    Args:
        message: The type.
        fields: Paths such as `header.stamp`. A path through an array means this field of all elements.
        pictures: Images are read as files, which have no fields.

    Raises:
        InvalidRequest: The type has no such field.
    """
    tree: Tree = {}
    for path in fields:
        _add(tree, path.split("."))
    return _select(message, tree, "", pictures)


def _add(tree: Tree, names: list[str]) -> None:
    """Add a path, unless a shorter one wants all of it."""
    for place, name in enumerate(names):
        if name in tree and not tree[name]:
            return
        tree = tree.setdefault(name, {})
        if place == len(names) - 1:
            tree.clear()


def _select(message: Message, tree: Tree, path: str, pictures: bool) -> Message:
    if pictures and message.name == IMAGE:
        raise _refused(path or next(iter(tree)), "an image that is sent as a file has no fields: use the format json")
    known = {member.field.name: member for member in message.members}
    for name in tree:
        if name not in known:
            hint = did_you_mean(name, known) or f"it has {', '.join(known) or 'none'}"
            raise _refused(join(path, name), f"{message.name} has no field {name[:40]!r}: {hint}")
    members = []
    for name, member in known.items():
        inside, here = tree.get(name), join(path, name)
        if inside is None:
            members.append(replace(member, wanted=False, message=member.message and unwanted(member.message)))
        elif not inside:
            members.append(member)
        elif member.message is None:
            raise _refused(join(here, next(iter(inside))), f"{here} is a {member.type.base}, which has no fields")
        else:
            members.append(replace(member, message=_select(member.message, inside, here, pictures)))
    return replace(message, members=tuple(members))


def unwanted(message: Message) -> Message:
    """Return a message type with the same layout, of which no field is wanted."""
    members = [replace(m, wanted=False, message=m.message and unwanted(m.message)) for m in message.members]
    return replace(message, members=tuple(members))


def _refused(path: str, reason: str) -> InvalidRequest:
    return InvalidRequest(f"delivery.fields: {path[:200]}: {reason}", field="delivery.fields")

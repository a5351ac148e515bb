"""Commands as frames: one command per frame and without default values, exactly as the original's clients send them."""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec

from rce.errors import AlreadyExists, NotFound, RceError
from rce.protocol.messages import (
    CN_ITEMS,
    CX_ITEMS,
    Command,
    CreateContainer,
    DeleteParameter,
    DestroyContainer,
    Disconnect,
    LeaveService,
    RemoveInterface,
    RemoveNode,
    RemoveRecorder,
    UseService,
)

LISTS = {kind: ("CN", name) for name, kind in CN_ITEMS.items()} | {
    kind: ("CX", name) for name, kind in CX_ITEMS.items()
}
"""Frame type and the name of the list in it, by command."""

REMOVALS = (DestroyContainer, RemoveNode, RemoveInterface, DeleteParameter, RemoveRecorder, LeaveService, Disconnect)


def frame_of(command: Command) -> dict[str, Any]:
    """Return the frame that carries one command."""
    if isinstance(command, CreateContainer):
        options = {"size": command.containerData.size, **msgspec.to_builtins(command.containerData)}
        return {"type": "CC", "data": {"containerTag": command.containerTag, "containerData": options}}
    if isinstance(command, DestroyContainer):
        return {"type": "DC", "data": {"containerTag": command.containerTag}}
    frame_type, name = LISTS[type(command)]
    return {"type": frame_type, "data": {name: [fields_of(command)]}}


def fields_of(command: Command) -> dict[str, Any]:
    """Return the JSON object of a command, without the fields that have their default value."""
    values = ((encoded, getattr(command, name), default) for encoded, name, default in _fields(type(command)))
    return {name: msgspec.to_builtins(value) for name, value, default in values if value != default}


@cache
def _fields(kind: type[Command]) -> list[tuple[str, str, Any]]:
    """Return the fields of a kind: name in JSON, name, default. msgspec resolves their annotations at each request."""
    return [(each.encode_name, each.name, _default(each)) for each in msgspec.structs.fields(kind)]


def _default(field: msgspec.structs.FieldInfo) -> Any:
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()


def already_done(command: Command, error: RceError) -> bool:
    """Return True if `error`, the answer to a repeated command, means that an earlier attempt was executed."""
    if isinstance(command, UseService):  # the platform answers it again, with the interfaces
        return False
    return isinstance(error, NotFound if isinstance(command, REMOVALS) else AlreadyExists)

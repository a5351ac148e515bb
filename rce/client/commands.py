"""Commands as the frames that the original's clients send, without what is at its default; what a robot declared."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from rce.errors import AlreadyExists, NotFound, RceError
from rce.messages import (
    CN_ITEMS,
    CX_ITEMS,
    AddInterface,
    Command,
    Connect,
    CreateContainer,
    DeleteParameter,
    DestroyContainer,
    Disconnect,
    RemoveInterface,
    RemoveNode,
)
from rce.names import is_guest

LISTS = {kind: ("CN", name) for name, kind in CN_ITEMS.items()} | {
    kind: ("CX", name) for name, kind in CX_ITEMS.items()
}
UNDOING = (DestroyContainer, RemoveNode, RemoveInterface, DeleteParameter, Disconnect)


def frame_of(command: Command) -> dict[str, Any]:
    """The frame of one command, as the original's clients send it: a list of one."""
    if isinstance(command, CreateContainer):
        options = {"size": command.containerData.size, **msgspec.to_builtins(command.containerData)}
        return {"type": "CC", "data": {"containerTag": command.containerTag, "containerData": options}}
    if isinstance(command, DestroyContainer):
        return {"type": "DC", "data": {"containerTag": command.containerTag}}
    frame_type, name = LISTS[type(command)]
    return {"type": frame_type, "data": {name: [fields(command)]}}


def fields(command: Command) -> dict[str, Any]:
    """A command as JSON, without what is at its default."""
    given = (
        (each.encode_name, getattr(command, each.name), _default(each)) for each in msgspec.structs.fields(command)
    )
    return {name: msgspec.to_builtins(value) for name, value, default in given if value != default}


def _default(field: msgspec.structs.FieldInfo) -> Any:
    return field.default if field.default_factory is msgspec.NODEFAULT else field.default_factory()


def repetition_done(command: Command, error: RceError) -> bool:
    """Whether `error`, the answer to a command sent twice, says that the first one was carried out."""
    return isinstance(error, NotFound if isinstance(command, UNDOING) else AlreadyExists)


@dataclass
class Declared:
    """What this robot has of its own at the platform, to be declared again when a session could not be resumed."""

    robot: str
    interfaces: dict[str, AddInterface] = field(default_factory=dict)
    connections: dict[frozenset[str], Connect] = field(default_factory=dict)

    def note(self, command: Command) -> None:
        """Take account of a command that was carried out."""
        if isinstance(command, AddInterface) and self._is_own(command.endpointTag, command.interfaceTag):
            self.interfaces[f"{command.endpointTag}/{command.interfaceTag}"] = command
        elif isinstance(command, RemoveInterface):
            self._forget(lambda tag: tag == f"{command.endpointTag}/{command.interfaceTag}")
        elif isinstance(command, DestroyContainer):
            self._forget(lambda tag: tag.startswith(f"{command.containerTag}/"))
        elif isinstance(command, Connect | Disconnect):
            self._connection(command)

    def commands(self) -> list[Command]:
        """What declares all of it again."""
        return [*self.interfaces.values(), *self.connections.values()]

    def _is_own(self, endpoint: str, interface: str) -> bool:
        """What ends with the robot: its own interfaces, and those that it made in environments as a guest."""
        return endpoint == self.robot or (is_guest(self.robot) and interface.startswith(f"{self.robot}."))

    def _connection(self, command: Connect | Disconnect) -> None:
        tags = frozenset((command.tagA, command.tagB))
        if isinstance(command, Disconnect):
            self.connections.pop(tags, None)
        elif any(tag.startswith(f"{self.robot}/") for tag in tags):
            self.connections[tags] = command

    def _forget(self, gone: Callable[[str], bool]) -> None:
        for tag in [tag for tag in self.interfaces if gone(tag)]:
            del self.interfaces[tag]
        for tags in [tags for tags in self.connections if any(gone(tag) for tag in tags)]:
            del self.connections[tags]

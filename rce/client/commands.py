"""Commands as frames: what is left at its default is left out, as the original's clients do."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from rce.errors import AlreadyExists, NotFound, RceError
from rce.messages import (
    CN_ITEMS,
    CX_ITEMS,
    AddInterface,
    Command,
    Connect,
    CreateContainer,
    DestroyContainer,
    Disconnect,
    RemoveInterface,
)

LISTS = {kind: ("CN", name) for name, kind in CN_ITEMS.items()} | {
    kind: ("CX", name) for name, kind in CX_ITEMS.items()
}
_item = re.compile(r"(\w+)\[(\d+)\]")


class CommandFrame(NamedTuple):
    """A CC, DC, CN or CX, and its commands in the order in which the server carries them out."""

    type: str
    data: dict[str, Any]
    commands: list[Command]

    def position(self, error: RceError) -> int:
        """Which of the commands failed; those before it are done."""
        place = _item.fullmatch(error.item)
        if place is None:
            return 0
        earlier = 0
        for name, items in self.data.items():
            if name == place[1]:
                return min(earlier + int(place[2]), len(self.commands) - 1)
            earlier += len(items)
        return 0


def frames(commands: Iterable[Command]) -> list[CommandFrame]:
    """The fewest frames for these commands: each CC, then one CN, one CX, then each DC."""
    given = list(commands)
    found = [
        CommandFrame("CC", {"containerTag": each.containerTag, "containerData": _container_data(each)}, [each])
        for each in given
        if isinstance(each, CreateContainer)
    ]
    for frame_type, lists in (("CN", CN_ITEMS), ("CX", CX_ITEMS)):
        ordered = [each for kind in lists.values() for each in given if isinstance(each, kind)]
        data: dict[str, Any] = {}
        for each in ordered:
            data.setdefault(LISTS[type(each)][1], []).append(fields(each))
        if ordered:
            found.append(CommandFrame(frame_type, data, ordered))
    found += [
        CommandFrame("DC", {"containerTag": each.containerTag}, [each])
        for each in given
        if isinstance(each, DestroyContainer)
    ]
    return found


def fields(command: Command) -> dict[str, Any]:
    """A command as JSON, without what is at its default."""
    given: dict[str, Any] = msgspec.to_builtins(command)
    kinds = {each.encode_name: each for each in msgspec.structs.fields(command)}
    return {name: value for name, value in given.items() if value != msgspec.to_builtins(kinds[name].default)}


def _container_data(command: CreateContainer) -> dict[str, Any]:
    return {"size": command.containerData.size, **msgspec.to_builtins(command.containerData)}


def repetition_done(command: Command, error: RceError) -> bool:
    """Whether `error`, the answer to a command sent twice, says that the first one was carried out."""
    undoing = isinstance(command, DestroyContainer | Disconnect) or LISTS.get(type(command), ("", ""))[1].startswith(
        ("remove", "delete")
    )
    return isinstance(error, NotFound if undoing else AlreadyExists)


@dataclass
class Declared:
    """What this robot has of its own at the platform, to be declared again when a session could not be resumed."""

    robot: str
    interfaces: dict[str, AddInterface] = field(default_factory=dict)
    connections: dict[frozenset[str], Connect] = field(default_factory=dict)

    def note(self, commands: Sequence[Command]) -> None:
        """Take account of commands that were carried out."""
        for command in commands:
            if isinstance(command, AddInterface) and command.endpointTag == self.robot:
                self.interfaces[command.interfaceTag] = command
            elif isinstance(command, RemoveInterface):
                if command.endpointTag == self.robot:
                    self.interfaces.pop(command.interfaceTag, None)
                self._forget(f"{command.endpointTag}/{command.interfaceTag}")
            elif isinstance(command, DestroyContainer):
                self._forget(f"{command.containerTag}/")
            elif isinstance(command, Connect | Disconnect):
                self._connection(command)

    def commands(self) -> list[Command]:
        """What declares all of it again."""
        return [*self.interfaces.values(), *self.connections.values()]

    def _connection(self, command: Connect | Disconnect) -> None:
        tags = frozenset((command.tagA, command.tagB))
        if isinstance(command, Disconnect):
            self.connections.pop(tags, None)
        elif any(tag.startswith(f"{self.robot}/") for tag in tags):
            self.connections[tags] = command

    def _forget(self, tag: str) -> None:
        gone = [
            tags
            for tags in self.connections
            if any(each == tag or (tag.endswith("/") and each.startswith(tag)) for each in tags)
        ]
        for tags in gone:
            del self.connections[tags]

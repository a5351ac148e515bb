"""Interfaces and connections of a robot, recorded so that they can be declared again.

The platform removes the interfaces that a robot has added to environments when the robot leaves for good, if it is
connected with them and nobody else is. They are recorded with its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from rce.protocol.messages import (
    AddInterface,
    Command,
    Connect,
    DestroyContainer,
    Disconnect,
    LeaveService,
    RemoveInterface,
    UseService,
)
from rce.protocol.names import is_guest


@dataclass
class Declarations:
    """Record of what belongs to one robot's session and is lost with it.

    When a new session could not resume the old one, `commands` restores all of it.
    """

    robot: str
    interfaces: dict[str, AddInterface] = field(default_factory=dict)
    counterparts: dict[str, AddInterface] = field(default_factory=dict)  # in environments
    connections: dict[frozenset[str], Connect] = field(default_factory=dict)
    services: dict[str, UseService] = field(default_factory=dict)

    def record(self, command: Command) -> None:
        """Update the record after a command was executed."""
        if isinstance(command, AddInterface):
            of = self.interfaces if self._is_own(command) else self.counterparts
            of[f"{command.endpointTag}/{command.interfaceTag}"] = command
        elif isinstance(command, RemoveInterface):
            self._forget(lambda tag: tag == f"{command.endpointTag}/{command.interfaceTag}")
        elif isinstance(command, DestroyContainer):
            self._forget(lambda tag: tag.startswith(f"{command.containerTag}/"))
        elif isinstance(command, UseService):
            self.services[command.containerTag] = command
        elif isinstance(command, LeaveService):
            self.services.pop(command.containerTag, None)
        elif isinstance(command, Connect | Disconnect):
            self._record_connection(command)

    def record_existing(self, command: Command) -> None:
        """Update the record after a command failed because what it adds exists already."""
        if isinstance(command, AddInterface) and not self._is_own(command):
            self.record(command)

    def connection_gone(self, one: str, other: str) -> None:
        """Update the record after the platform removed a connection."""
        self.connections.pop(frozenset((one, other)), None)

    def commands(self) -> list[Command]:
        """Return the commands that declare everything again, in a valid order."""
        connected = {tag for pair in self.connections for tag in pair}
        counterparts = [command for tag, command in self.counterparts.items() if tag in connected]
        return [*self.interfaces.values(), *counterparts, *self.connections.values(), *self.services.values()]

    def _is_own(self, command: AddInterface) -> bool:
        """Return True for interfaces that end with the robot: its own and, for a guest, its own in environments."""
        is_guests = is_guest(self.robot) and command.interfaceTag.startswith(f"{self.robot}.")
        return command.endpointTag == self.robot or is_guests

    def _record_connection(self, command: Connect | Disconnect) -> None:
        tags = frozenset((command.tagA, command.tagB))
        if isinstance(command, Disconnect):
            self.connections.pop(tags, None)
        elif any(tag.startswith(f"{self.robot}/") for tag in tags):
            self.connections[tags] = command

    def _forget(self, is_removed: Callable[[str], bool]) -> None:
        for recorded in (self.interfaces, self.counterparts):
            for tag in [tag for tag in recorded if is_removed(tag)]:
                del recorded[tag]
        for tags in [tags for tags in self.connections if any(is_removed(tag) for tag in tags)]:
            del self.connections[tags]

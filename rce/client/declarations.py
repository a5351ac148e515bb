"""Interfaces and connections of a robot, recorded so that they can be declared again."""

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
    connections: dict[frozenset[str], Connect] = field(default_factory=dict)
    services: dict[str, UseService] = field(default_factory=dict)

    def record(self, command: Command) -> None:
        """Update the record after a command was executed."""
        if isinstance(command, AddInterface) and self._is_own(command.endpointTag, command.interfaceTag):
            self.interfaces[f"{command.endpointTag}/{command.interfaceTag}"] = command
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

    def connection_gone(self, one: str, other: str) -> None:
        """Update the record after the platform removed a connection."""
        self.connections.pop(frozenset((one, other)), None)

    def commands(self) -> list[Command]:
        """Return the commands that declare everything again, in a valid order."""
        return [*self.interfaces.values(), *self.connections.values(), *self.services.values()]

    def _is_own(self, endpoint: str, interface: str) -> bool:
        """Return True for interfaces that end with the robot: its own and, for a guest, its own in environments."""
        return endpoint == self.robot or (is_guest(self.robot) and interface.startswith(f"{self.robot}."))

    def _record_connection(self, command: Connect | Disconnect) -> None:
        tags = frozenset((command.tagA, command.tagB))
        if isinstance(command, Disconnect):
            self.connections.pop(tags, None)
        elif any(tag.startswith(f"{self.robot}/") for tag in tags):
            self.connections[tags] = command

    def _forget(self, is_removed: Callable[[str], bool]) -> None:
        for tag in [tag for tag in self.interfaces if is_removed(tag)]:
            del self.interfaces[tag]
        for tags in [tags for tags in self.connections if any(is_removed(tag) for tag in tags)]:
            del self.connections[tags]

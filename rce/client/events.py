"""What a robot hears beside its messages: environments, nodes, drops, limits, its own connection, errors."""

from __future__ import annotations

from typing import NamedTuple

from rce.errors import RceError
from rce.messages import DropEvent, EnvironmentEvent, LimitEvent, NodeEvent


class Disconnected(NamedTuple):
    """The socket broke; the robot is connecting again."""

    reason: str


class Reconnected(NamedTuple):
    """The robot is back. If not `resumed`, it is declaring its interfaces and connections again."""

    resumed: bool


Event = EnvironmentEvent | NodeEvent | DropEvent | LimitEvent | Disconnected | Reconnected | RceError
"""An RceError is one that answers no command: a message that could not be converted, or any of the original server."""

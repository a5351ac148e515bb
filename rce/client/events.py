"""Events of a robot besides its messages: environments, nodes, connections, drops, limits, errors."""

from __future__ import annotations

from typing import NamedTuple

from rce.errors import RceError
from rce.protocol.messages import ConnectionEvent, DropEvent, EnvironmentEvent, LimitEvent, NodeEvent, RecorderEvent


class Disconnected(NamedTuple):
    """The socket broke. The robot reconnects by itself until it succeeds, is closed, or is refused by the platform.

    Attributes:
        reason: Reason of the close frame, or the close code if there is none.
    """

    reason: str


class Reconnected(NamedTuple):
    """The robot has a connection again.

    Attributes:
        resumed: True if the platform kept the session with its interfaces and connections. False if it is a new
            session, in which the robot is now declaring them again. Environments and nodes exist independently of it.
    """

    resumed: bool


PlatformEvent = EnvironmentEvent | NodeEvent | RecorderEvent | DropEvent | ConnectionEvent | LimitEvent
"""Events that the platform sends."""

Event = PlatformEvent | Disconnected | Reconnected | RceError
"""Item of the stream that `Robot.events` returns.

- `EnvironmentEvent`: an environment is ready, failed to start, was lost, or is gone.
- `NodeEvent`: a node ended; with its exit status and the last lines of its output.
- `RecorderEvent`: a recorder ended by itself; with the reason.
- `DropEvent`: the platform dropped messages of one of the robot's interfaces, with their number and the place.
- `ConnectionEvent`: a connection that the robot made waits for an end that is away, is restored, or is gone.
- `LimitEvent`: a limit of the user was reached.
- `Disconnected` and `Reconnected`: changes of the robot's own connection.
- `RceError`: an error that answers no command of this client, for example of a message that could not be converted.
  A server of the original reports all errors this way.
"""

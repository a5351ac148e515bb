"""Python client library: a robot that exchanges messages and commands with an RCE platform.

`Robot` is the asyncio client and `BlockingRobot` the same for plain threads. Both keep their session alive: after a
broken socket they reconnect, restore their interfaces and connections, and repeat the commands that have no answer yet.
The library needs neither ROS nor any of the optional extras, except `rce.client.images`, which needs the extra
`images`. Errors are those of `rce.errors`.

Servers of the original RoboEarth Cloud Engine work too. They do not acknowledge commands, so a command returns as soon
as it has been sent, and its errors arrive in `Robot.events()`.

This package holds what runs inside a robot's own program: the WebSocket session, the robot's interfaces, robot files
(`rce run`) and the client of the map service. The client of the HTTP API is `rce.api.client`.
"""

from rce.client.actions import ActionClient, ActionServer, Goal, GoalResult, ServerGoal
from rce.client.blocking import BlockingRobot
from rce.client.catalogue import Service
from rce.client.environment import Environment
from rce.client.events import Disconnected, Event, Reconnected
from rce.client.robot import Robot
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.store import Store
from rce.client.stream import Stream
from rce.client.topics import Publisher, Subscriber

__all__ = [
    "ActionClient",
    "ActionServer",
    "BlockingRobot",
    "Disconnected",
    "Environment",
    "Event",
    "Goal",
    "GoalResult",
    "Publisher",
    "Reconnected",
    "Robot",
    "ServerGoal",
    "Service",
    "ServiceClient",
    "ServiceProvider",
    "Store",
    "Stream",
    "Subscriber",
]

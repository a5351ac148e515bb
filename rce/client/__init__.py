"""The client library: a robot at the platform, with asyncio or (`BlockingRobot`) without.

Needs neither ROS nor more than the base install; `rce.client.images` wants the extra `images`. Errors are those of
`rce.errors`. It works with servers of the original RoboEarth Cloud Engine too: their commands end when they are sent,
and what goes wrong shows in `Robot.events()`.
"""

from rce.client.blocking import BlockingRobot
from rce.client.environment import Environment
from rce.client.events import Disconnected, Event, Reconnected
from rce.client.robot import Robot
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.stream import Stream
from rce.client.topics import Publisher, Subscriber

__all__ = [
    "BlockingRobot",
    "Disconnected",
    "Environment",
    "Event",
    "Publisher",
    "Reconnected",
    "Robot",
    "ServiceClient",
    "ServiceProvider",
    "Stream",
    "Subscriber",
]

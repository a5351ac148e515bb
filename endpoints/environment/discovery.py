"""Finding out when nodes have discovered the subscriptions of this process.

ROS 2 tells a process what it has discovered, not by whom it was discovered. Until a node has discovered a subscription,
its messages are lost to it. `after_discovery` sends an empty request to the parameter services of the node. rmw sends
the response only when it has discovered its reader, and DDS announces the readers of a process in the order in which
they were created, over a reliable writer (RTPS 2.3, section 8.5.4). So the node has then discovered all earlier ones.

A process with several nodes discovers once for all of them, so that one of them is asked. It is found by the DDS topic
of its service: the names of nodes come later than their subscriptions.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.srv import GetParameterTypes
from rclpy.serialization import serialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.ros import Ros
from endpoints.environment.ros_services import RawClient

SETTLING_TIME = 0.1  # seconds to wait for nodes without parameter services, which cannot be asked
# Seconds to wait for the answer of a node. It may be busy, and Fast DDS often tells of the reader of its service 0.1 s
# before it tells of the writer.
LIMIT = 0.5
# The node first has to discover the client. A request that comes earlier is lost, and sent again after 0.07 s.
HEAD_START = 0.01  # seconds
SERVICE = "/get_parameter_types"
PREFIX = 12  # bytes of a gid that are those of its process

Peers = Callable[[], list[TopicEndpointInfo]]


def after_discovery(
    ros: Ros, peers: Peers, action: Callable[[], None], clock: Callable[[], float] = time.monotonic
) -> None:
    """Run `action` when nodes have discovered the subscriptions that this process has now.

    Args:
        ros: The ROS node.
        peers: Returns subscriptions or publishers of the nodes, which may not all be known at first.
        action: It runs after `LIMIT` at the latest.
        clock: Source of the time in seconds.
    """
    _Wait(ros, peers, action, clock).proceed()


class _Wait:
    """The processes that were asked, by the prefixes of their gids."""

    def __init__(self, ros: Ros, peers: Peers, action: Callable[[], None], clock: Callable[[], float]) -> None:
        self._ros = ros
        self._peers = peers
        self._action = action
        self._clock = clock
        self._began = clock()
        self._asked: dict[bytes, _Question] = {}

    def proceed(self) -> None:
        """Ask processes that have become known; end the wait, or look again soon."""
        wanted = {bytes(info.endpoint_gid[:PREFIX]) for info in self._peers()}
        if missing := wanted - self._asked.keys():
            for prefix, service in _services(self._ros).items():
                if prefix in missing:
                    self._asked[prefix] = _Question(self._ros, service, self._clock)
        questions = self._asked.values()
        for question in questions:
            question.ask()
        answered = bool(wanted) and all(each in self._asked and self._asked[each].answered for each in wanted)
        pending = not all(question.answered for question in questions)
        if answered or self._clock() - self._began >= (LIMIT if pending else SETTLING_TIME):
            for question in questions:
                question.end()
            self._action()
        else:
            self._ros.retry(self.proceed)


def _services(ros: Ros) -> dict[bytes, str]:
    """Return a parameter service of each process, by the prefix of its gids."""
    names = [name for name, _ in ros.node.get_service_names_and_types() if name.endswith(SERVICE)]
    found = {}
    for name in names:
        for info in ros.node.get_subscriptions_info_by_topic(f"rq{name}Request", no_mangle=True):
            found[bytes(info.endpoint_gid[:PREFIX])] = name
    return found


class _Question:
    """An empty request to the parameter services of a node."""

    def __init__(self, ros: Ros, service: str, clock: Callable[[], float]) -> None:
        self.sent = self.answered = False
        self._ros = ros
        self._clock = clock
        self._made = clock()
        self._client = RawClient(ros, GetParameterTypes, service, self._answer)

    def ask(self) -> None:
        """Send the request if that was not done, the node had time to discover the client, and the service is there."""
        if not self.sent and self._clock() - self._made >= HEAD_START and self._client.available():
            self.sent = True
            self._client.call(serialize_message(GetParameterTypes.Request()))

    def _answer(self, number: int, response: bytes) -> None:
        self.answered = True

    def end(self) -> None:
        """Remove the client."""
        self._client.destroy()

"""Finding out when nodes have discovered the subscriptions of this process.

ROS 2 tells a process what it has discovered, not by whom it was discovered. Until a node has discovered a subscription,
its messages are lost to it. `after_discovery` sends an empty request to the parameter services of the node. rmw sends
the response only when it has discovered its reader, and DDS announces the readers of a process in the order in which
they were created, over a reliable writer (RTPS 2.3, section 8.5.4). So the node has then discovered all earlier ones.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from rcl_interfaces.srv import GetParameterTypes
from rclpy.serialization import serialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.ros import RosThread
from endpoints.environment.ros_services import RawClient

SETTLING_TIME = 0.1  # seconds to wait for nodes without parameter services, which cannot be asked
LIMIT = 0.5  # seconds to wait for the answer of a node, which may be busy
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # name of a node whose description has not come yet

Nodes = Callable[[], list[TopicEndpointInfo]]


def after_discovery(
    ros: RosThread, nodes: Nodes, action: Callable[[], None], clock: Callable[[], float] = time.monotonic
) -> None:
    """Run `action` when nodes have discovered the subscriptions that this process has now; called in the ROS thread.

    Args:
        ros: The ROS thread.
        nodes: Returns subscriptions or publishers of the nodes, which may not all be known at first.
        action: It runs after `LIMIT` at the latest.
        clock: Source of the time in seconds.
    """
    _Wait(ros, nodes, action, clock).proceed()


class _Wait:
    """The nodes that were asked."""

    def __init__(self, ros: RosThread, nodes: Nodes, action: Callable[[], None], clock: Callable[[], float]) -> None:
        self._ros = ros
        self._nodes = nodes
        self._action = action
        self._clock = clock
        self._began = clock()
        self._asked: dict[str, _Question] = {}

    def proceed(self) -> None:
        """Ask nodes that have become known; end the wait, or look again soon."""
        waited = self._clock() - self._began
        names = [_full_name(info) for info in self._nodes()]
        for name in names:
            if name and name not in self._asked:
                self._asked[name] = _Question(self._ros, name)
        for question in self._asked.values():
            question.ask()
        answered = bool(names) and all(name and self._asked[name].answered for name in names)
        pending = any(question.sent and not question.answered for question in self._asked.values())
        if answered or waited >= (LIMIT if pending else SETTLING_TIME):
            for question in self._asked.values():
                question.end()
            self._action()
        else:
            self._ros.retry(self.proceed)


class _Question:
    """An empty request to the parameter services of a node."""

    def __init__(self, ros: RosThread, node: str) -> None:
        self.sent = self.answered = False
        self._ros = ros
        self._client = RawClient(ros, GetParameterTypes, f"{node}/get_parameter_types", self._answer)

    def ask(self) -> None:
        """Send the request if that was not done, and the service is there."""
        if not self.sent and self._client.available():
            self.sent = True
            self._client.call(serialize_message(GetParameterTypes.Request()))

    def _answer(self, number: int, response: bytes) -> None:
        self.answered = True

    def end(self) -> None:
        """Remove the client."""
        self._ros.remove_waitable(self._client)


def _full_name(info: TopicEndpointInfo) -> str:
    """Return the name of a node with its namespace; empty if it is not known."""
    return "" if info.node_name == UNKNOWN else f"{info.node_namespace.rstrip('/')}/{info.node_name}"

"""ROS 2 node `rce_knowledge`: the services of re_srvs under `/re_comm`, for programs that were written for RoboEarth.

The knowledge service answers, over the platform, with the rights of the owner of the environment. A request that fails
is answered with `success` false, or an empty result, and the reason is logged. The topic `/re_comm/changes`
(std_msgs/String) has a JSON object for each change of an entry that the owner may read, while somebody listens.
"""

from __future__ import annotations

import importlib
import re
from functools import partial
from typing import Any

import msgspec
import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from re_msgs.msg import File, RosFile, StringArray
from std_msgs.msg import String

from rce.api.knowledge import Change
from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import RceError

from .follower import Follower
from .handlers import Handler, handlers
from .repository import Repository

THREADS = 4  # requests at a time
PREFIX = "/re_comm"


class KnowledgeNode(Node):
    """Node with a service for each handler."""

    def __init__(self, knowledge: EnvironmentKnowledge | None = None) -> None:
        """Offer the services.

        Raises:
            Unavailable: This is no program in an environment.
        """
        super().__init__("rce_knowledge")
        client = knowledge or EnvironmentKnowledge()
        repository = Repository(client)
        types = importlib.import_module("re_srvs.srv")
        group = ReentrantCallbackGroup()
        for name, handler in handlers(repository, File, RosFile, StringArray).items():
            answer = partial(self._answer, handler)
            self.create_service(getattr(types, name), service_name(name), answer, callback_group=group)

        self._changes = self.create_publisher(String, f"{PREFIX}/changes", 100)
        self._follower = Follower(client, self._changes.get_subscription_count, self._publish)

    def destroy_node(self) -> None:
        """Stop following changes, then destroy the node."""
        self._follower.stop()
        super().destroy_node()

    def _publish(self, change: Change) -> None:
        self._changes.publish(String(data=msgspec.json.encode(change).decode()))

    def _answer(self, handler: Handler, request: Any, response: Any) -> Any:
        try:
            fields = handler(request)
        except RceError as error:
            self.get_logger().error(f"{type(request).__name__.removesuffix('_Request')}: {error}")
            return response
        for name, value in fields.items():
            setattr(response, name, value)
        if hasattr(response, "success"):
            response.success = True
        return response


def service_name(name: str) -> str:
    """Return the name of the service of a type: `/re_comm/get_action_recipe` for GetActionRecipe."""
    words = re.findall(r"2D|[A-Z][a-z]*", name)
    return f"{PREFIX}/{'_'.join(word.lower() for word in words)}"


def main() -> int:
    """Run the node until SIGINT or SIGTERM, which are a normal end; return the exit status."""
    rclpy.init()
    try:
        executor = MultiThreadedExecutor(THREADS)
        executor.add_node(KnowledgeNode())
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    finally:
        rclpy.try_shutdown()
    return 0

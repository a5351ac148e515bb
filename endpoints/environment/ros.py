"""The ROS node of an endpoint.

All rclpy entities are created, used and destroyed in the thread of the asyncio loop: rclpy's entities belong to one
thread, and a second one would hand each message over to the loop, which costs 0.1 ms and more. There is no executor and
no wait set either. Listeners of DDS wake the loop (see `ros_listener`).
"""

from __future__ import annotations

import asyncio
import weakref
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from endpoints.environment.ros_listener import Action, Listener, attempt

if TYPE_CHECKING:
    from endpoints.environment.ros_listener import Entity

    TopicEntity = _rclpy.Publisher[Any] | _rclpy.Subscription[Any]

NODE = "_rce_endpoint"  # a leading underscore hides it from lists of nodes
RETRY_INTERVAL = 0.005  # seconds between checks of conditions for which ROS has no event


class _Group(MutuallyExclusiveCallbackGroup):
    """Forgets entities that are gone; rclpy's groups keep a weak reference to each for ever."""

    def add_entity(self, entity: Any) -> None:  # rclpy defines their type for type checkers only
        self.entities.add(weakref.ref(entity, self.entities.discard))


class _Node(Node):
    """Node whose entities come and go with the interfaces of robots."""

    def __init__(self, name: str, context: Context) -> None:
        self._group = _Group()
        super().__init__(
            name, context=context, use_global_arguments=False, enable_rosout=False, start_parameter_services=False
        )

    @property
    def default_callback_group(self) -> CallbackGroup:
        return self._group


class Ros:
    """A context of rclpy with one node.

    Attributes:
        node: The node.
        prefix: First 12 bytes of the gids of all publishers of this process.
    """

    def __init__(self, name: str = NODE) -> None:
        """Join the ROS domain; called in the asyncio loop. Raises the error of rclpy if it cannot."""
        self._loop = asyncio.get_running_loop()
        self._context = Context()
        self._listeners: set[Listener] = set()
        self._retries: dict[Action, None] = {}
        # Its messages are in the log of the endpoint; a file of its own would be in the user's home.
        args = ["--ros-args", "--disable-external-lib-logs"]
        rclpy.init(context=self._context, args=args, signal_handler_options=SignalHandlerOptions.NO)
        self.node: Node = _Node(name, self._context)
        own = [info for info in self.node.get_publishers_info_by_topic("/parameter_events") if info.node_name == name]
        self.prefix = bytes(own[0].endpoint_gid[:12])

    def close(self) -> None:
        """Destroy all entities, and leave the ROS domain."""
        for listener in list(self._listeners):
            self.end(listener)
        self.node.destroy_node()
        self._context.try_shutdown()

    def listen(self, action: Action, *entities: Entity) -> Listener:
        """Run `action` in the loop when the entities have something new."""
        listener = Listener(self._loop, action, entities)
        self._listeners.add(listener)
        return listener

    def listen_to_events(self, action: Action, of: TopicEntity, kinds: Sequence[Any]) -> Listener:
        """Run `action` in the loop when a publisher or subscription has new events of these kinds."""
        return self.listen(action, *(_rclpy.EventHandle(of, kind) for kind in kinds))

    def end(self, listener: Listener) -> None:
        """End a listener, before its entities are destroyed."""
        self._listeners.discard(listener)
        listener.close()

    def call_soon(self, action: Action) -> None:
        """Run `action` after others have had their turn."""
        self._loop.call_soon(self._run, action)

    def call_later(self, seconds: float, action: Action) -> None:
        """Run `action` after `seconds`."""
        self._loop.call_later(seconds, self._run, action)

    def retry(self, action: Action) -> None:
        """Run `action` after RETRY_INTERVAL seconds, to check a condition for which ROS has no event."""
        if not self._retries:
            self._loop.call_later(RETRY_INTERVAL, self._run_retries)
        self._retries[action] = None

    def _run_retries(self) -> None:
        retries, self._retries = self._retries, {}
        for action in retries:
            self._run(action)

    def _run(self, action: Action) -> None:
        """Run an action, unless its entities are gone."""
        if self._context.ok():
            attempt(action)

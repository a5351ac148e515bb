"""Handle of an environment, through which one robot uses its topics and services."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from contextlib import suppress
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from rce.errors import AlreadyExists
from rce.protocol.messages import CodecName, Delivery, InterfaceType, NodeRestart, ParameterValue, Qos
from rce.protocol.names import is_guest

if TYPE_CHECKING:  # Robot imports this module
    from rce.client.actions import Accept, ActionClient, ActionServer, Handler
    from rce.client.backlog import Offline
    from rce.client.operations import EnvironmentOptions, Format
    from rce.client.robot import Robot
    from rce.client.services import ServiceClient, ServiceProvider
    from rce.client.store import Store
    from rce.client.topics import Publisher, Subscriber


class Environment:
    """Environment as one robot uses it; made by `Robot.environment`.

    As an asynchronous context manager it creates the environment on entry and destroys it on exit. To use an
    environment that this program does not own, use the handle without `async with`.

    A program that was killed leaves its environment behind. When it is started again it takes over what it finds,
    unless `exist_ok` is false: the environment with its options, and each node that it adds in the same way as before.
    A node that it adds in another way is replaced.

    `publisher`, `subscriber`, `service_client`, `service_provider`, `action_client` and `action_server` connect the
    robot to a topic, service or action of the environment in one step: each adds an interface to the environment and
    one to the robot and connects the two. The tag of the former is made from the ROS name, that of the latter
    additionally has the environment's name before it. Robots that use the same topic share the interface in the
    environment; a guest has its own, which is removed with it.

    The commands behave as those of `Robot`, also while the robot is offline.

    Attributes:
        robot: The robot that uses the environment.
        tag: Name of the environment.
    """

    def __init__(self, robot: Robot, tag: str, options: EnvironmentOptions, exist_ok: bool = True) -> None:
        self.robot = robot
        self.tag = tag
        self._options = options
        self._exist_ok = exist_ok

    async def __aenter__(self) -> Self:
        await self.robot.create_environment(self.tag, exist_ok=self._exist_ok, **self._options)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.destroy()

    async def destroy(self) -> None:
        """Stop the environment and remove its nodes, parameters, interfaces and connections.

        Raises:
            NotFound: It does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.destroy_environment(self.tag)

    async def add_node(
        self,
        tag: str,
        pkg: str,
        exe: str = "",
        *,
        args: str = "",
        name: str = "",
        namespace: str = "",
        restart: NodeRestart = "",
        launch: str = "",
    ) -> None:
        """Start a ROS 2 node in the environment.

        Args:
            tag: Name by which the platform knows the node, unique within the environment.
            pkg: ROS package.
            exe: Executable of the package.
            args: Command line arguments. `$(find PKG)` and `$(env VAR)` are substituted.
            name: ROS name of the node in place of the one in its code.
            namespace: ROS namespace of the node.
            restart: When to start it again after it ended by itself: `on-failure`, `always` or `no`, with pauses that
                grow to 30 s. Empty: after a failure, if it ran for 5 s and the environment has not `restart="no"`.
            launch: Launch file of the package, in place of `exe`; its arguments are `args`, as `NAME:=VALUE`. Its nodes
                get the tags `TAG.NAME`, and start and end together.

        Raises:
            AlreadyExists: The environment has a node with this tag, and its `exist_ok` is false.
            StartFailed: The node did not start.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.add_node(
            self.tag,
            tag,
            pkg,
            exe,
            args=args,
            name=name,
            namespace=namespace,
            exist_ok=self._exist_ok,
            restart=restart,
            launch=launch,
        )

    async def remove_node(self, tag: str) -> None:
        """Stop a node.

        Args:
            tag: Name of the node, as given to `add_node`.

        Raises:
            NotFound: There is no such node.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.remove_node(self.tag, tag)

    async def set_parameter(self, name: str, value: ParameterValue, *, node: str = "") -> None:
        """Set a ROS 2 parameter.

        Args:
            name: Name of the parameter.
            value: A bool, number, string or a list of one of these.
            node: Tag of the only node that gets the parameter. Without it, all nodes that are started later get it,
                and so do running ones that have declared it.

        Raises:
            NotFound: The environment or the node does not exist.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.set_parameter(self.tag, name, value, node=node)

    async def delete_parameter(self, name: str, *, node: str = "") -> None:
        """Remove a parameter that was set with `set_parameter`; nodes that are started later do not get it.

        Args:
            name: Name of the parameter.
            node: Tag of the node for which it was set, if it was set for one only.

        Raises:
            NotFound: There is no such parameter.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.delete_parameter(self.tag, name, node=node)

    async def add_recorder(self, tag: str, *topics: str, max_size: int = 0, max_duration: float = 0.0) -> None:
        """Record topics on the machine of the environment, until the recorder or the environment is removed.

        Args:
            tag: Name of the recorder, unique within the environment.
            *topics: Topics to record, also before they exist; without any, all that are not hidden.
            max_size: Bytes of a file after which the next one begins; 0 is no limit.
            max_duration: Seconds of a file after which the next one begins; 0 is no limit.

        Raises:
            AlreadyExists: The environment has a recorder with this tag; with `exist_ok`, it is kept or replaced.
            LimitExceeded: The quota for recordings is used up.
            StartFailed: The machine of the environment keeps no recordings.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.add_recorder(
            self.tag, tag, *topics, max_size=max_size, max_duration=max_duration, exist_ok=self._exist_ok
        )

    async def remove_recorder(self, tag: str) -> None:
        """End a recorder, and complete its file. Its recordings are kept.

        Args:
            tag: Name of the recorder, as given to `add_recorder`.

        Raises:
            NotFound: There is no such recorder.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        await self.robot.remove_recorder(self.tag, tag)

    async def publisher(
        self,
        topic: str,
        type_name: str,
        *,
        qos: Qos | None = None,
        raw: bool = False,
        format: Format = "png",
        offline: Offline | Store = "drop",
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> Publisher:
        """Publish on a topic of the environment.

        Args:
            topic: ROS topic, for example `/scan`.
            type_name: ROS message type, for example `sensor_msgs/LaserScan`.
            qos: Quality of service of the ROS publisher, and history and depth of the queue at the platform.
            raw: Send serialized ROS messages (CDR) as bytes instead of dicts; with a `codec`, packets as dicts.
            format: Encoding of `sensor_msgs/Image` messages: PNG or JPEG bytes, or dicts (`json`). Raw messages may be
                `ros1`. Other formats are converters of the Robot endpoint.
            offline: What `publish(…, wait=False)` does with messages that cannot be sent: `drop`, keep the `newest`, or
                `store` in memory or in the file of a `Store`; see `Publisher`.
            delivery: Priority, greatest age and rate of messages on the line from the robot.
            codec: Codec of images and clouds, which the robot sends as packets: `h264`, `palette`, `quantised` and
                others of the protocol. Messages are numpy arrays then.

        Returns:
            A connected publisher.

        Raises:
            AlreadyExists: The robot uses this topic in the same way already.
            NotFound: The environment does not exist.
            NotConnectable: Another robot uses the topic with another type.
            NotConnected: The connection was not ready within 10 s.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        to = await self._interface(topic, "pub", "PublisherInterface", type_name, qos)
        tag = self._own_tag(to)
        return await self.robot.publisher(
            tag, type_name, to=to, raw=raw, format=format, qos=qos, offline=offline, delivery=delivery, codec=codec
        )

    async def subscriber(
        self,
        topic: str,
        type_name: str,
        *,
        callback: Callable[[Any], Awaitable[None] | None] | None = None,
        depth: int = 0,
        qos: Qos | None = None,
        raw: bool = False,
        format: Format = "png",
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> Subscriber:
        """Subscribe to a topic of the environment.

        Args:
            topic: ROS topic.
            type_name: ROS message type.
            callback: Function or coroutine function to call with each message; see `Robot.subscriber`.
            depth: Unread messages to keep; when there are more, the oldest is dropped. 0: 1000, of images and point
                clouds 10.
            qos: Quality of service of the ROS subscription, and history and depth of the queue at the platform.
            raw: Receive serialized ROS messages (CDR) as bytes instead of dicts; with a `codec`, packets as dicts.
            format: Encoding in which `sensor_msgs/Image` messages arrive: PNG or JPEG bytes, or dicts (`json`); other
                formats as for `publisher`.
            delivery: Priority, greatest age, rate, fields and decimation of messages on the line to the robot.
            codec: Codec in which images and clouds come, as for `publisher`.

        Returns:
            A connected subscriber.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        to = await self._interface(topic, "sub", "SubscriberInterface", type_name, qos)
        return await self.robot.subscriber(
            self._own_tag(to),
            type_name,
            to=to,
            callback=callback,
            depth=depth,
            raw=raw,
            format=format,
            qos=qos,
            delivery=delivery,
            codec=codec,
        )

    async def service_client(self, service: str, type_name: str, *, raw: bool = False) -> ServiceClient:
        """Return a client of a service that a node of the environment offers.

        Args:
            service: ROS service, for example `/get_map`.
            type_name: ROS service type, for example `nav_msgs/GetMap`.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        to = await self._interface(service, "call", "ServiceClientInterface", type_name)
        return await self.robot.service_client(self._own_tag(to), type_name, to=to, raw=raw)

    async def service_provider(
        self, service: str, type_name: str, handler: Callable[[Any], Any], *, raw: bool = False
    ) -> ServiceProvider:
        """Offer a service to the nodes of the environment.

        Args:
            service: ROS service.
            type_name: ROS service type.
            handler: Function or coroutine function that gets the request and returns the response; see
                `Robot.service_provider`.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        to = await self._interface(service, "serve", "ServiceProviderInterface", type_name)
        return await self.robot.service_provider(self._own_tag(to), type_name, handler, to=to, raw=raw)

    async def action_client(self, action: str, type_name: str, *, raw: bool = False) -> ActionClient:
        """Return a client of an action that a node of the environment offers.

        Args:
            action: ROS action, for example `/navigate_to_pose`.
            type_name: ROS action type, for example `nav2_msgs/NavigateToPose`.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        to = await self._interface(action, "ask", "ActionClientInterface", type_name)
        return await self.robot.action_client(self._own_tag(to), type_name, to=to, raw=raw)

    async def action_server(
        self,
        action: str,
        type_name: str,
        handler: Handler,
        *,
        accept: Accept | None = None,
        raw: bool = False,
    ) -> ActionServer:
        """Offer an action to the nodes of the environment.

        Args:
            action: ROS action.
            type_name: ROS action type.
            handler: Coroutine function that carries out a goal; see `Robot.action_server`.
            accept: Function or coroutine function that gets the value of a goal and returns False to reject it.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        to = await self._interface(action, "act", "ActionProviderInterface", type_name)
        tag = self._own_tag(to)
        return await self.robot.action_server(tag, type_name, handler, accept=accept, to=to, raw=raw)

    async def _interface(
        self, address: str, verb: str, interface_type: InterfaceType, type_name: str, qos: Qos | None = None
    ) -> str:
        """Add the environment's interface for a topic, service or action unless it exists; return `ENDPOINT/TAG`."""
        prefix = f"{self.robot.name}." if is_guest(self.robot.name) else ""
        tag = f"{prefix}{verb}_{re.sub(r'[^A-Za-z0-9_]+', '_', address).strip('_')}"
        # It may be another robot's or left from an earlier run. If its type differs, connecting to it fails.
        with suppress(AlreadyExists):
            await self.robot.add_interface(self.tag, tag, interface_type, type_name, addr=address, qos=qos)
        return f"{self.tag}/{tag}"

    def _own_tag(self, to: str) -> str:
        """Return the tag of the robot's interface that is connected to `to`."""
        return to.replace(f"{self.robot.name}.", "").replace("/", "_")

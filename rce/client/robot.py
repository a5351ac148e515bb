"""Asyncio client of a robot: its session with the platform, its commands, and its interfaces."""

from __future__ import annotations

import asyncio
import ssl as tls
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar, Unpack

from rce.client.actions import Accept, ActionClient, ActionServer, Handler
from rce.client.address import Address
from rce.client.backlog import Offline
from rce.client.catalogue import Service
from rce.client.connection import Connection
from rce.client.declarations import Declarations
from rce.client.dispatcher import Dispatcher
from rce.client.environment import Environment
from rce.client.events import Event
from rce.client.interface import Interface
from rce.client.operations import EnvironmentOptions, Format, Operations
from rce.client.recordings import RecordingsClient
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.session import NAME_WAIT, ClientSession
from rce.client.store import Store
from rce.client.stored import make_publisher
from rce.client.stream import Stream
from rce.client.topics import Publisher, Subscriber
from rce.errors import AlreadyExists, RceError
from rce.protocol.messages import AddInterface, CodecName, Delivery, Qos
from rce.protocol.names import check_robot_id, check_tag

I = TypeVar("I", bound=Interface)  # noqa: E741


class Robot(Operations):
    """Robot that is connected to an RCE platform.

    Use it as an asynchronous context manager, which opens and closes it:

        async with Robot("https://rce.example.org/", user="ann", robot="r2d2", key=key) as robot:
            async with robot.environment("brain") as brain:
                await brain.add_node("mapper", "my_mapping", "mapper.py")
                scan = await brain.publisher("/scan", "sensor_msgs/LaserScan")
                await scan.publish(message)

    The robot stays connected until it is closed. When the socket breaks it reconnects, at once and then with
    exponential backoff from 0.1 s to 10 s. Within the platform's grace period it resumes its session, so its interfaces
    and connections are as they were; afterwards it declares them again in a new session. Environments and nodes exist
    independently of the connection. While the robot is offline:

    - Commands wait for the next connection. A command whose answer was lost is repeated, and succeeds if its first
      attempt was executed.
    - `Publisher.publish` waits, or with `wait=False` drops, keeps or stores as the publisher's `offline` says;
      `Publisher.offer` drops; messages that were lost with the socket are not sent again.
    - Service calls under way raise `Unavailable`, new ones wait.
    - `events()` reports `Disconnected` and `Reconnected`.

    If the platform refuses the robot on a reconnection (`Unauthorized`, `Forbidden`, or `NotFound` for `owner`), the
    robot ends: everything that waits raises that error, and so does every later command.

    A command waits until the platform has executed it. All commands raise:

    - `TimedOut` if there is no answer within `timeout`. The command may have been executed.
    - `Unavailable` if the robot has not been opened or has been closed.
    - Otherwise the error with which the platform answers, for example `NotFound`, `AlreadyExists`, `InvalidRequest`,
      `LimitExceeded` or `Forbidden`.

    With a server of the original, a command returns once it has been sent, and its error arrives in `events()`.

    A robot cannot be opened again after it was closed. All methods must be called on the event loop on which the robot
    was opened; for plain threads there is `BlockingRobot`.

    Args:
        url: URL of the Master's entry (http or https).
        user: User name.
        robot: robotID, unique among the user's robots. One that begins with `@` is a guest: it takes part in the
            data of `owner` for as long as it is connected, and what it makes is removed with it.
        password: Password in clear. Give either this or `key`.
        key: API key.
        timeout: Seconds after which a command without an answer raises `TimedOut`.
        compress: Compress all messages in both directions, for links on which that is faster.
        ssl: TLS context for https and wss in place of the system's certificates.
        owner: User whose guest the robot is; empty for `user` itself.

    Raises:
        InvalidName: `user` or `robot` is not a legal name.
        InvalidRequest: The URL is not http or https, or not exactly one of `password` and `key` is given.

    Attributes:
        name: The robotID.
    """

    def __init__(
        self,
        url: str,
        *,
        user: str,
        robot: str,
        password: str | None = None,
        key: str | None = None,
        timeout: float = 60.0,
        compress: bool = False,
        ssl: tls.SSLContext | None = None,
        owner: str = "",
    ) -> None:
        check_tag(user, "user")
        self.name = check_robot_id(robot, "robot")
        declarations = Declarations(robot)
        self._recordings = partial(RecordingsClient, url, user=user, password=password, key=key, ssl=ssl)
        self._dispatcher = Dispatcher(robot, declarations)
        address = Address(url, user, robot, password, key, compress, ssl, owner)
        super().__init__(ClientSession(address, self._dispatcher, timeout), declarations)

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def open(self, wait: float = NAME_WAIT) -> None:
        """Connect to the platform. After a failure it may be called again.

        A robot takes the place of an earlier one of the same name and user whose socket has broken. The platform
        notices that at once if the program was killed, and within 20 s if its machine was: until then this tries again.

        Args:
            wait: Seconds for which to try again while the name is in use.

        Raises:
            Unauthorized: The credentials are wrong.
            Forbidden: The credentials do not permit this robot.
            NotFound: `owner` does not exist.
            AlreadyExists: A robot or an environment of this name has been there for `wait` seconds.
            Unavailable: The platform cannot be reached.
            InvalidRequest: The robot has been opened before, or the platform rejects the request.
        """
        await self._session.open(wait)

    async def close(self) -> None:
        """Send the queued messages (for 5 s at most) and leave the platform.

        The robot's interfaces and connections are removed; environments stay until they are destroyed. Pending commands
        and calls raise `Unavailable`, subscribers and event streams end. Closing twice does nothing.
        """
        await self._session.close()

    @property
    def connection(self) -> Connection | None:
        """The open connection to a Robot endpoint, or None while the robot is offline."""
        return self._session.connection

    @property
    def connected(self) -> bool:
        """True while the robot is online."""
        return self.connection is not None

    @property
    def features(self) -> frozenset[str]:
        """Protocol features that the server granted; empty while offline and with a server of the original."""
        return self.connection.features if self.connection is not None else frozenset()

    def events(self) -> Stream[Event]:
        """Subscribe to the robot's events.

        Returns:
            A new stream of the events from now on, to be read with `async for`. It keeps the newest 1000 unread events
            and ends with the robot. If the platform refuses the robot, reading it raises that error.
        """
        return self._dispatcher.events()

    async def upload_recording(
        self, path: Path, name: str = "", progress: Callable[[int], None] = lambda _: None
    ) -> str:
        """Upload a recording that the robot made itself, or the rest of it; see `rce.bag.writer`.

        An upload that was interrupted goes on where it stopped, also in a later run of the program. Bytes of a file
        never count twice: one that is there already is not uploaded again.

        Args:
            path: MCAP file.
            name: Name in place of the file's own; letters, digits, `.`, `_` and `-`.
            progress: Function that is called, in another thread, with the number of bytes that have been sent.

        Returns:
            Name of the recording at the platform, `machine/id`.

        Raises:
            InvalidRequest: The file is no MCAP file.
            LimitExceeded: The quota for recordings is used up.
            Unavailable: There was no progress for a minute.
            RceError: Any other error of the platform.
        """
        upload = await asyncio.to_thread(self._recordings().upload, path, progress, name)
        return upload.id

    def environment(self, tag: str, *, exist_ok: bool = True, **options: Unpack[EnvironmentOptions]) -> Environment:
        """Return a handle of an environment, through which the robot uses its topics, services and nodes.

        This sends nothing; the environment may exist already. `async with robot.environment(...)` creates it with the
        given options and destroys it at the end.

        Args:
            tag: Name of the environment.
            exist_ok: Take over an environment of that name, whatever its options, and its nodes; so a program that was
                killed can be started again. If false, what exists raises `AlreadyExists`.
            **options: See `EnvironmentOptions`.
        """
        return Environment(self, tag, options, exist_ok)

    async def service(self, name: str, *, tag: str = "", raw: bool = False) -> Service:
        """Use a service of the platform's catalogue: it is started if needed, and connected to this robot.

        Args:
            name: Name of the service, as `mapping2d`, or `user/name` for one that another user offers.
            tag: Begins the names of the robot's interfaces, and names the environment if the service is not shared;
                by default the name of the service.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Returns:
            The service, with a connected interface for each topic, service and action that it declares.

        Raises:
            NotFound: There is no such service that this user may use.
            AlreadyExists: A name is in use already; give a tag.
            NoCapacity: All instances are full, or no machine has room.
            LimitExceeded: The user, or the publisher of the service, may not have more.
            StartFailed: The service did not start.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        return await Service.use(self, self._session, self._declarations, self._dispatcher, name, tag, raw)

    # --- interfaces

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        """Remove an interface and its connections; for one of the robot's own, pending reads and calls end at once.

        Args:
            endpoint: Name of the environment or the robotID.
            tag: Name of the interface.

        Raises:
            NotFound: There is no such interface.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open.
        """
        if endpoint == self.name and tag in self._dispatcher.interfaces:
            self._dispatcher.interfaces.pop(tag)._end(None)
        await super().remove_interface(endpoint, tag)

    async def publisher(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        raw: bool = False,
        format: Format = "png",
        qos: Qos | None = None,
        offline: Offline | Store = "drop",
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> Publisher:
        """Add an interface through which the robot sends messages.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS message type, for example `std_msgs/String`.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that publishes on a ROS
                topic, or one of another robot that receives. Without it the interface is not connected yet.
            raw: Send serialized ROS messages (CDR) as bytes instead of dicts; with a `codec`, packets as dicts.
            format: Encoding of `sensor_msgs/Image` messages: PNG or JPEG bytes, or dicts (`json`). Raw messages may be
                `ros1`. Other formats are converters of the Robot endpoint.
            qos: History and depth of the queue at the platform.
            offline: What `publish(…, wait=False)` does with messages that cannot be sent: `drop`, keep the `newest`, or
                `store` in memory or in the file of a `Store`; see `Publisher`.
            delivery: Priority, greatest age and rate of messages on the line to the platform.
            codec: Codec of images and clouds, which the robot sends as packets: `h264`, `palette`, `quantised` and
                others of the protocol. Messages are numpy arrays then.

        Returns:
            The publisher, with a peer if `to` is given.

        Raises:
            AlreadyExists: The robot has an interface with this tag.
            NotFound: The interface `to` does not exist.
            NotConnectable: `to` is not a receiving interface or has another type.
            NotConnected: `to` is not ready within 10 s.
            UnknownType: The platform does not know the type.
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, or `Unavailable` if the robot is not open. After any error the
                interface does not exist.
        """
        publisher = make_publisher(self, tag, type_name, offline, delivery or Delivery(), codec)
        return await self._add(publisher, "Subscriber", to, raw, format, qos, delivery, codec)

    async def subscriber(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        callback: Callable[[Any], Awaitable[None] | None] | None = None,
        depth: int = 0,
        raw: bool = False,
        format: Format = "png",
        qos: Qos | None = None,
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> Subscriber:
        """Add an interface through which the robot receives messages.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS message type.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that subscribes to a ROS
                topic, or one of another robot that sends. Without it the interface is not connected yet.
            callback: Function or coroutine function to call with each message, one after the other. Without it,
                messages are read from the subscriber.
            depth: Unread messages to keep; when there are more, the oldest is dropped. 0: 1000, of images and point
                clouds 10.
            raw: Receive serialized ROS messages (CDR) as bytes instead of dicts; with a `codec`, packets as dicts.
            format: Encoding in which `sensor_msgs/Image` messages arrive: PNG or JPEG bytes, or dicts (`json`); other
                formats as for `publisher`.
            qos: History and depth of the queue at the platform.
            delivery: Priority, greatest age, rate, fields and decimation of messages on the line from the platform.
            codec: Codec in which images and clouds come, as for `publisher`.

        Returns:
            The subscriber, with a peer if `to` is given.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        subscriber = Subscriber(self, tag, type_name, depth, "" if raw else codec)
        if callback is not None:
            subscriber.call(callback)
        return await self._add(subscriber, "Publisher", to, raw, format, qos, delivery, codec)

    async def service_client(
        self, tag: str, type_name: str, *, to: str = "", raw: bool = False, format: Format = "png"
    ) -> ServiceClient:
        """Add an interface through which the robot calls a service.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS service type, for example `std_srvs/SetBool`.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that calls a ROS service, or
                a service provider of another robot.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.
            format: With `raw`, `ros1` for messages as ROS 1 serializes them.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        return await self._add(ServiceClient(self, tag, type_name), "ServiceProvider", to, raw, format)

    async def service_provider(
        self,
        tag: str,
        type_name: str,
        handler: Callable[[Any], Any],
        *,
        to: str = "",
        raw: bool = False,
        format: Format = "png",
    ) -> ServiceProvider:
        """Add an interface through which the robot offers a service.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS service type.
            handler: Function or coroutine function that gets the request and returns the response. An exception is sent
                to the caller as an error with its message.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that offers a ROS service, or
                a service client of another robot.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.
            format: With `raw`, `ros1` for messages as ROS 1 serializes them.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        return await self._add(ServiceProvider(self, tag, type_name, handler), "ServiceClient", to, raw, format)

    async def action_client(self, tag: str, type_name: str, *, to: str = "", raw: bool = False) -> ActionClient:
        """Add an interface through which the robot sends goals to an action server.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS action type, for example `nav2_msgs/NavigateToPose`.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that is a client of a ROS
                action, or an action server of another robot.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        return await self._add(ActionClient(self, tag, type_name), "ActionProvider", to, raw)

    async def action_server(
        self,
        tag: str,
        type_name: str,
        handler: Handler,
        *,
        accept: Accept | None = None,
        to: str = "",
        raw: bool = False,
    ) -> ActionServer:
        """Add an interface through which the robot carries out goals.

        Args:
            tag: Name of the interface, unique within the robot.
            type_name: ROS action type.
            handler: Coroutine function that gets a `ServerGoal`, carries it out and returns the result; see
                `ActionServer`. Goals run concurrently.
            accept: Function or coroutine function that gets the value of a goal and returns False to reject it; without
                it all are accepted.
            to: Interface to connect it to, as `endpoint/interface`: one of an environment that offers a ROS action, or
                an action client of another robot.
            raw: Exchange serialized ROS messages (CDR) as bytes instead of dicts.

        Raises:
            RceError: The same errors as `publisher`, for the same reasons.
        """
        return await self._add(ActionServer(self, tag, type_name, handler, accept), "ActionClient", to, raw)

    async def _add(
        self,
        interface: I,
        kind: str,
        to: str,
        raw: bool,
        format: Format = "png",
        qos: Qos | None = None,
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> I:
        """Add the interface and connect it to `to`; remove it again if that fails."""
        tag = interface.tag
        interfaces = self._dispatcher.interfaces
        if tag in interfaces:
            raise AlreadyExists(f"{self.name}/{tag} exists already: close it first or use another tag")
        interfaces[tag] = interface
        kind += "Forwarder" if raw and not codec else "Converter"
        try:
            options = (qos or Qos(), format, delivery or Delivery(), codec)
            await self.configure(AddInterface(self.name, tag, kind, interface.type_name, "", *options))
        except RceError:
            interfaces.pop(tag)._end(None)
            raise
        if to:
            try:
                await self.connect(to, f"{self.name}/{tag}")
                if not interface.was_connected:  # else its peer may have gone before the command was acknowledged
                    await interface.wait_connected()
            except RceError:
                await interface.close()
                raise
        return interface

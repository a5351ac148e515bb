"""Blocking client: the operations of the asyncio client for scripts and plain threads, without an event loop.

The asyncio robot runs in a background thread. Callbacks and handlers run in further threads, so they may block and may
use the robot themselves.
"""

from __future__ import annotations

import functools
import inspect
import ssl as tls
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar, Unpack

from rce.client.blocking_interfaces import (
    BlockingActionClient,
    BlockingActionServer,
    BlockingInterface,
    BlockingPublisher,
    BlockingServerGoal,
    BlockingServiceClient,
    BlockingServiceProvider,
    BlockingSubscriber,
    goals_in_threads,
    in_thread,
)
from rce.client.catalogue import Service
from rce.client.environment import Environment
from rce.client.events import Event
from rce.client.interface import Interface
from rce.client.operations import EnvironmentOptions, Format
from rce.client.robot import Robot
from rce.client.session import NAME_WAIT
from rce.client.threads import Blocking, BlockingStream, LoopThread, blocking
from rce.protocol.messages import CodecName, Delivery, Qos

P = ParamSpec("P")
W = TypeVar("W")
I = TypeVar("I", bound=Interface)  # noqa: E741
B = TypeVar("B", bound="BlockingInterface[Any]")


def blocking_factory(
    method: Callable[Concatenate[W, P], Coroutine[Any, Any, I]], kind: Callable[[LoopThread, I], B]
) -> Callable[Concatenate[Blocking[W], P], B]:
    """Turn a coroutine method that returns an interface into one that blocks and returns a `kind` of that interface."""

    @functools.wraps(method)
    def call(self: Blocking[W], /, *arguments: P.args, **options: P.kwargs) -> B:
        return kind(self._thread, self._thread.wait(method(self.inner, *arguments, **options)))

    signature = inspect.signature(method).replace(return_annotation=kind)
    call.__signature__ = signature  # type: ignore[attr-defined]  # what `help` shows; functions may have it
    return call


class BlockingService(Blocking[Service]):
    """Blocking `Service`: as a context manager it leaves the service at the end."""

    leave = blocking(Service.leave)
    """Use the service no longer; see `Service.leave`."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.leave()

    def publisher(self, name: str) -> BlockingPublisher:
        """Return the publisher for a topic that the service takes; see `Service.publisher`."""
        return BlockingPublisher(self._thread, self.inner.publisher(name))

    def subscriber(self, name: str) -> BlockingSubscriber:
        """Return the subscriber of a topic that the service gives; see `Service.subscriber`."""
        return BlockingSubscriber(self._thread, self.inner.subscriber(name))

    def service_client(self, name: str) -> BlockingServiceClient:
        """Return the client of a ROS service; see `Service.service_client`."""
        return BlockingServiceClient(self._thread, self.inner.service_client(name))

    def action_client(self, name: str) -> BlockingActionClient:
        """Return the client of a ROS action; see `Service.action_client`."""
        return BlockingActionClient(self._thread, self.inner.action_client(name))


class BlockingEnvironment(Blocking[Environment]):
    """Blocking `Environment`: as a context manager it creates the environment and destroys it at the end."""

    destroy = blocking(Environment.destroy)
    """Stop the environment and remove everything in it; see `Environment.destroy`."""
    add_node = blocking(Environment.add_node)
    """Start a ROS 2 node; see `Environment.add_node`."""
    remove_node = blocking(Environment.remove_node)
    """Stop a node; see `Environment.remove_node`."""
    set_parameter = blocking(Environment.set_parameter)
    """Set a ROS 2 parameter; see `Environment.set_parameter`."""
    delete_parameter = blocking(Environment.delete_parameter)
    """Remove a parameter; see `Environment.delete_parameter`."""
    add_recorder = blocking(Environment.add_recorder)
    """Record topics on the machine of the environment; see `Environment.add_recorder`."""
    remove_recorder = blocking(Environment.remove_recorder)
    """End a recorder; see `Environment.remove_recorder`."""
    publisher = blocking_factory(Environment.publisher, BlockingPublisher)
    """Publish on a topic of the environment; see `Environment.publisher`."""
    service_client = blocking_factory(Environment.service_client, BlockingServiceClient)
    """Return a client of a service of the environment; see `Environment.service_client`."""
    action_client = blocking_factory(Environment.action_client, BlockingActionClient)
    """Return a client of an action of the environment; see `Environment.action_client`."""

    @property
    def tag(self) -> str:
        """Name of the environment."""
        return self.inner.tag

    def __enter__(self) -> Self:
        self._thread.wait(self.inner.__aenter__())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.destroy()

    def subscriber(
        self,
        topic: str,
        type_name: str,
        *,
        callback: Callable[[Any], None] | None = None,
        depth: int = 0,
        qos: Qos | None = None,
        raw: bool = False,
        format: Format = "png",
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> BlockingSubscriber:
        """Subscribe to a topic of the environment; see `Environment.subscriber`.

        A callback runs in another thread, for one message after the other, and may block.
        """
        call = in_thread(callback) if callback is not None else None
        subscriber = self._thread.wait(
            self.inner.subscriber(
                topic,
                type_name,
                callback=call,
                depth=depth,
                qos=qos,
                raw=raw,
                format=format,
                delivery=delivery,
                codec=codec,
            )
        )
        return BlockingSubscriber(self._thread, subscriber)

    def service_provider(
        self, service: str, type_name: str, handler: Callable[[Any], Any], *, raw: bool = False
    ) -> BlockingServiceProvider:
        """Offer a service to the nodes of the environment; see `Environment.service_provider`.

        The handler runs in other threads, concurrently for concurrent calls, and may block.
        """
        provider = self._thread.wait(self.inner.service_provider(service, type_name, in_thread(handler), raw=raw))
        return BlockingServiceProvider(self._thread, provider)

    def action_server(
        self,
        action: str,
        type_name: str,
        handler: Callable[[BlockingServerGoal], Any],
        *,
        accept: Callable[[Any], bool] | None = None,
        raw: bool = False,
    ) -> BlockingActionServer:
        """Offer an action to the nodes of the environment; see `Environment.action_server`.

        The handler runs in other threads, concurrently for concurrent goals, and looks at `canceled` of its goal.
        """
        inside = goals_in_threads(self._thread, handler)
        server = self._thread.wait(self.inner.action_server(action, type_name, inside, accept=accept, raw=raw))
        return BlockingActionServer(self._thread, server)


class BlockingRobot(Blocking[Robot]):
    """Blocking `Robot` for scripts and plain threads.

    Use it as a context manager, which opens and closes it:

        with BlockingRobot("https://rce.example.org/", user="ann", robot="r2d2", key=key) as robot:
            with robot.environment("brain") as brain:
                scan = brain.publisher("/scan", "sensor_msgs/LaserScan")
                scan.publish(message)

    Its methods have the arguments, results and errors of those of `Robot`, and the same behaviour while offline, but
    they block until they are done. They may be called from any thread, by several at once. Ctrl-C interrupts a blocked
    call. Before `open` and after `close` they raise `Unavailable`. Callbacks and handlers run in threads of their own
    and may use the robot.

    Args:
        url: URL of the Master's entry (http or https).
        user: User name.
        robot: robotID; one that begins with `@` is a guest (see `Robot`).
        password: Password in clear. Give either this or `key`.
        key: API key.
        timeout: Seconds after which a command without an answer raises `TimedOut`.
        compress: Compress all messages in both directions, for links on which that is faster.
        ssl: TLS context for https and wss in place of the system's certificates.
        owner: User whose guest the robot is; empty for `user` itself.

    Raises:
        InvalidName: `user` or `robot` is not a legal name.
        InvalidRequest: The URL is not http or https, or not exactly one of `password` and `key` is given.
    """

    create_environment = blocking(Robot.create_environment)
    """Start an environment; see `Robot.create_environment`."""
    destroy_environment = blocking(Robot.destroy_environment)
    """Stop an environment and remove everything in it; see `Robot.destroy_environment`."""
    add_node = blocking(Robot.add_node)
    """Start a ROS 2 node; see `Robot.add_node`."""
    remove_node = blocking(Robot.remove_node)
    """Stop a node; see `Robot.remove_node`."""
    set_parameter = blocking(Robot.set_parameter)
    """Set a ROS 2 parameter; see `Robot.set_parameter`."""
    delete_parameter = blocking(Robot.delete_parameter)
    """Remove a parameter; see `Robot.delete_parameter`."""
    add_recorder = blocking(Robot.add_recorder)
    """Record topics of an environment on its machine; see `Robot.add_recorder`."""
    remove_recorder = blocking(Robot.remove_recorder)
    """End a recorder; see `Robot.remove_recorder`."""
    upload_recording = blocking(Robot.upload_recording)
    """Upload a recording of the robot's own; see `Robot.upload_recording`."""
    add_interface = blocking(Robot.add_interface)
    """Add an interface to an environment or a robot; see `Robot.add_interface`."""
    remove_interface = blocking(Robot.remove_interface)
    """Remove an interface and its connections; see `Robot.remove_interface`."""
    connect = blocking(Robot.connect)
    """Connect two interfaces; see `Robot.connect`."""
    disconnect = blocking(Robot.disconnect)
    """Remove the connection between two interfaces; see `Robot.disconnect`."""
    configure = blocking(Robot.configure)
    """Execute several commands in their order; see `Robot.configure`."""
    publisher = blocking_factory(Robot.publisher, BlockingPublisher)
    """Add an interface through which the robot sends messages; see `Robot.publisher`."""
    service_client = blocking_factory(Robot.service_client, BlockingServiceClient)
    """Add an interface through which the robot calls a service; see `Robot.service_client`."""
    action_client = blocking_factory(Robot.action_client, BlockingActionClient)
    """Add an interface through which the robot sends goals; see `Robot.action_client`."""

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
        inner = Robot(
            url,
            user=user,
            robot=robot,
            password=password,
            key=key,
            timeout=timeout,
            compress=compress,
            ssl=ssl,
            owner=owner,
        )
        super().__init__(LoopThread(), inner)

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def open(self, wait: float = NAME_WAIT) -> None:
        """Connect to the platform. Once only: after a failure or `close`, make a new robot.

        Args:
            wait: Seconds for which to try again while the name is in use.

        Raises:
            InvalidRequest: The robot has been opened before, or the platform rejects the request.
            RceError: The connection failed; see `Robot.open`.
        """
        self._thread.start()
        try:
            self._thread.wait(self.inner.open(wait))
        except BaseException:
            self._thread.stop()
            raise

    def close(self) -> None:
        """Send the queued messages (for 5 s at most) and leave the platform; see `Robot.close`.

        Calls that block in other threads end with `Unavailable`, iterations end. Closing twice does nothing.
        """
        if not self._thread.running:
            return
        try:
            self._thread.wait(self.inner.close())
        finally:
            self._thread.stop()

    @property
    def name(self) -> str:
        """The robotID."""
        return self.inner.name

    @property
    def connected(self) -> bool:
        """True while the robot is online."""
        return self.inner.connected

    @property
    def features(self) -> frozenset[str]:
        """Protocol features that the server granted; empty while offline and with a server of the original."""
        return self.inner.features

    def events(self) -> BlockingStream[Event]:
        """Return a stream of the events from now on, to be iterated over; see `Robot.events`."""
        return BlockingStream(self._thread, self._thread.call(self.inner.events))

    def environment(
        self, tag: str, *, exist_ok: bool = True, **options: Unpack[EnvironmentOptions]
    ) -> BlockingEnvironment:
        """Return a handle of an environment; see `Robot.environment`.

        `with robot.environment(...)` creates it and destroys it at the end.
        """
        return BlockingEnvironment(self._thread, self.inner.environment(tag, exist_ok=exist_ok, **options))

    def service(self, name: str, *, tag: str = "", raw: bool = False) -> BlockingService:
        """Use a service of the platform's catalogue; see `Robot.service`."""
        return BlockingService(self._thread, self._thread.wait(self.inner.service(name, tag=tag, raw=raw)))

    def subscriber(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        callback: Callable[[Any], None] | None = None,
        depth: int = 0,
        raw: bool = False,
        format: Format = "png",
        qos: Qos | None = None,
        delivery: Delivery | None = None,
        codec: CodecName = "",
    ) -> BlockingSubscriber:
        """Add an interface through which the robot receives messages; see `Robot.subscriber`.

        A callback runs in another thread, for one message after the other, and may block.
        """
        call = in_thread(callback) if callback is not None else None
        subscriber = self._thread.wait(
            self.inner.subscriber(
                tag,
                type_name,
                to=to,
                callback=call,
                depth=depth,
                raw=raw,
                format=format,
                qos=qos,
                delivery=delivery,
                codec=codec,
            )
        )
        return BlockingSubscriber(self._thread, subscriber)

    def service_provider(
        self,
        tag: str,
        type_name: str,
        handler: Callable[[Any], Any],
        *,
        to: str = "",
        raw: bool = False,
        format: Format = "png",
    ) -> BlockingServiceProvider:
        """Add an interface through which the robot offers a service; see `Robot.service_provider`.

        The handler runs in other threads, concurrently for concurrent calls, and may block.
        """
        inside = in_thread(handler)
        provider = self._thread.wait(self.inner.service_provider(tag, type_name, inside, to=to, raw=raw, format=format))
        return BlockingServiceProvider(self._thread, provider)

    def action_server(
        self,
        tag: str,
        type_name: str,
        handler: Callable[[BlockingServerGoal], Any],
        *,
        accept: Callable[[Any], bool] | None = None,
        to: str = "",
        raw: bool = False,
    ) -> BlockingActionServer:
        """Add an interface through which the robot carries out goals; see `Robot.action_server`.

        The handler runs in other threads, concurrently for concurrent goals, and looks at `canceled` of its goal.
        """
        inside = goals_in_threads(self._thread, handler)
        server = self._thread.wait(self.inner.action_server(tag, type_name, inside, accept=accept, to=to, raw=raw))
        return BlockingActionServer(self._thread, server)

"""The client library for scripts: the same operations, which block, from any thread and without an event loop.

A thread of its own runs the asyncio robot. Callbacks and handlers run in other threads, so they may block and may use
the robot themselves.
"""

from __future__ import annotations

import asyncio
import ssl as tls
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Self, TypeVar, Unpack

from rce.client.environment import Environment
from rce.client.events import Event
from rce.client.interface import Interface
from rce.client.operations import EnvironmentOptions, Format
from rce.client.robot import Robot
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.threads import Blocking, BlockingStream, LoopThread, blocking
from rce.client.topics import Publisher, Subscriber
from rce.messages import Qos

I = TypeVar("I", bound=Interface)  # noqa: E741


class BlockingInterface(Blocking[I]):
    """See `Interface`."""

    @property
    def connected(self) -> bool:
        return self.inner.connected

    @property
    def tag(self) -> str:
        return self.inner.tag

    def wait_connected(self, timeout: float = 10.0) -> None:
        """Wait for a peer. Raises NotConnected after `timeout` seconds."""
        self._thread.wait(self.inner.wait_connected(timeout))

    def close(self) -> None:
        """Remove the interface and its connections."""
        self._thread.wait(self.inner.close())


class BlockingPublisher(BlockingInterface[Publisher]):
    """See `Publisher`."""

    publish = blocking(Publisher.publish)

    def offer(self, value: Any, keep: int = 1) -> bool:
        """See `Publisher.offer`."""
        return self._thread.call(lambda: self.inner.offer(value, keep))


class BlockingSubscriber(BlockingInterface[Subscriber]):
    """See `Subscriber`: iterate over it, or `get` the next message."""

    get = blocking(Subscriber.get)

    @property
    def dropped(self) -> int:
        return self.inner.dropped

    def __iter__(self) -> Iterator[Any]:
        return iter(BlockingStream(self._thread, self.inner.stream))


class BlockingServiceClient(BlockingInterface[ServiceClient]):
    """See `ServiceClient`."""

    call = blocking(ServiceClient.call)


class BlockingServiceProvider(BlockingInterface[ServiceProvider]):
    """See `ServiceProvider`."""


class BlockingEnvironment(Blocking[Environment]):
    """See `Environment`: as a context it is created, and destroyed at the end."""

    destroy = blocking(Environment.destroy)
    add_node = blocking(Environment.add_node)
    remove_node = blocking(Environment.remove_node)
    set_parameter = blocking(Environment.set_parameter)
    delete_parameter = blocking(Environment.delete_parameter)

    @property
    def tag(self) -> str:
        return self.inner.tag

    def __enter__(self) -> Self:
        self._thread.wait(self.inner.__aenter__())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.destroy()

    def publisher(self, topic: str, type_name: str, *, qos: Qos | None = None, raw: bool = False) -> BlockingPublisher:
        """See `Environment.publisher`."""
        made = self._thread.wait(self.inner.publisher(topic, type_name, qos=qos, raw=raw))
        return BlockingPublisher(self._thread, made)

    def subscriber(
        self,
        topic: str,
        type_name: str,
        *,
        callback: Callable[[Any], None] | None = None,
        depth: int = 10,
        qos: Qos | None = None,
        raw: bool = False,
    ) -> BlockingSubscriber:
        """See `Environment.subscriber`."""
        call = _in_thread(callback) if callback is not None else None
        made = self._thread.wait(self.inner.subscriber(topic, type_name, callback=call, depth=depth, qos=qos, raw=raw))
        return BlockingSubscriber(self._thread, made)

    def service_client(self, service: str, type_name: str, *, raw: bool = False) -> BlockingServiceClient:
        """See `Environment.service_client`."""
        made = self._thread.wait(self.inner.service_client(service, type_name, raw=raw))
        return BlockingServiceClient(self._thread, made)

    def service_provider(
        self, service: str, type_name: str, handler: Callable[[Any], Any], *, raw: bool = False
    ) -> BlockingServiceProvider:
        """See `Environment.service_provider`; calls run at the same time."""
        made = self._thread.wait(self.inner.service_provider(service, type_name, _in_thread(handler), raw=raw))
        return BlockingServiceProvider(self._thread, made)


class BlockingRobot(Blocking[Robot]):
    """See `Robot`. Use it as `with BlockingRobot(…) as robot`."""

    create_environment = blocking(Robot.create_environment)
    destroy_environment = blocking(Robot.destroy_environment)
    add_node = blocking(Robot.add_node)
    remove_node = blocking(Robot.remove_node)
    set_parameter = blocking(Robot.set_parameter)
    delete_parameter = blocking(Robot.delete_parameter)
    add_interface = blocking(Robot.add_interface)
    remove_interface = blocking(Robot.remove_interface)
    connect = blocking(Robot.connect)
    disconnect = blocking(Robot.disconnect)
    configure = blocking(Robot.configure)

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
        """As `Robot`."""
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

    def open(self) -> None:
        """Connect; see `Robot.open`. A robot that was closed cannot be opened again."""
        self._thread.start()
        try:
            self._thread.wait(self.inner.open())
        except BaseException:
            self._thread.stop()
            raise

    def close(self) -> None:
        """Send what is queued and leave; see `Robot.close`."""
        if not self._thread.running:
            return
        try:
            self._thread.wait(self.inner.close())
        finally:
            self._thread.stop()

    @property
    def name(self) -> str:
        return self.inner.name

    @property
    def connected(self) -> bool:
        return self.inner.connected

    @property
    def features(self) -> frozenset[str]:
        return self.inner.features

    def events(self) -> BlockingStream[Event]:
        """What happens from now on; see `Robot.events`."""
        return BlockingStream(self._thread, self._thread.call(self.inner.events))

    def environment(self, tag: str, **options: Unpack[EnvironmentOptions]) -> BlockingEnvironment:
        """See `Robot.environment`."""
        return BlockingEnvironment(self._thread, self.inner.environment(tag, **options))

    def publisher(
        self, tag: str, type_name: str, *, to: str = "", raw: bool = False, format: Format = "png"
    ) -> BlockingPublisher:
        """See `Robot.publisher`."""
        made = self._thread.wait(self.inner.publisher(tag, type_name, to=to, raw=raw, format=format))
        return BlockingPublisher(self._thread, made)

    def subscriber(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        callback: Callable[[Any], None] | None = None,
        depth: int = 10,
        raw: bool = False,
        format: Format = "png",
    ) -> BlockingSubscriber:
        """See `Robot.subscriber`."""
        call = _in_thread(callback) if callback is not None else None
        made = self._thread.wait(
            self.inner.subscriber(tag, type_name, to=to, callback=call, depth=depth, raw=raw, format=format)
        )
        return BlockingSubscriber(self._thread, made)

    def service_client(self, tag: str, type_name: str, *, to: str = "", raw: bool = False) -> BlockingServiceClient:
        """See `Robot.service_client`."""
        made = self._thread.wait(self.inner.service_client(tag, type_name, to=to, raw=raw))
        return BlockingServiceClient(self._thread, made)

    def service_provider(
        self, tag: str, type_name: str, handler: Callable[[Any], Any], *, to: str = "", raw: bool = False
    ) -> BlockingServiceProvider:
        """See `Robot.service_provider`; calls run at the same time."""
        made = self._thread.wait(self.inner.service_provider(tag, type_name, _in_thread(handler), to=to, raw=raw))
        return BlockingServiceProvider(self._thread, made)


def _in_thread(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: asyncio.to_thread(function, value)

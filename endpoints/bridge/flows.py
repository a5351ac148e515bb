"""What a bridge carries. A flow joins an interface in the robot's ROS with one of the environment, while it is open."""

from __future__ import annotations

import asyncio
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, Literal

import msgspec
from twisted.logger import Logger

from endpoints.bridge.config import BridgeConfig, Service, Topic, Transforms
from endpoints.bridge.ends import CLOUD, CloudEnd, LocalRos, MakeInterface
from endpoints.bridge.filters import Filter, Pace, as_picture, chosen_transforms, from_picture
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.services import TIMEOUT, ServiceClientInterface, ServiceProviderInterface
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from endpoints.frames import Message
from endpoints.interface import error_of
from rce.blobs import Buffer
from rce.client import Environment
from rce.errors import ConversionError, RceError
from rce.messages import Qos

TF_TYPE = "tf2_msgs/TFMessage"
STATIC = Qos(reliability="reliable", durability="transient_local", depth=100)
TF = Qos(depth=100)

log = Logger()


class Flow(CloudEnd, ABC):
    """One thing that is carried; it is itself the peer of its interface in the robot's ROS."""

    def __init__(self) -> None:
        super().__init__()
        self._local: LocalRos | None = None
        self._near: RosInterface | None = None

    @abstractmethod
    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Raises what one of the two ends says."""

    async def join(
        self, local: LocalRos, make: MakeInterface, type_name: str, address: str, qos: Qos | None = None
    ) -> None:
        """Make the interface in the robot's ROS."""
        self._local, self._near = local, await local.interface(make, type_name, address, self, qos)

    def deliver(self, message: Message) -> None:
        """To the robot's ROS."""
        if self._near is not None:
            self._near.traffic.of(CLOUD).passed(len(message.payload))
            self._near.receive(message, self)

    def end(self) -> None:
        """The interface in the robot's ROS goes; those of the environment go with the robot's session."""
        if self._local is not None and self._near is not None:
            self._local.remove(self._near)
        self._near = None


class _Complaints:
    """Says each sentence once."""

    def __init__(self) -> None:
        self._said: set[str] = set()

    def __call__(self, topic: str, error: RceError) -> None:
        if str(error) not in self._said:
            self._said.add(str(error))
            log.warn("{topic}: {error}", topic=topic, error=str(error))


class SentTopic(Flow):
    """A topic of the robot that is published in the environment too."""

    def __init__(self, topic: Topic, filter: Filter | None = None) -> None:
        super().__init__()
        self._topic = topic
        self._filter = filter or (as_picture(topic.format) if topic.format else None)
        self._pace = Pace(topic.rate)
        self._complain = _Complaints()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        topic = self._topic
        raw = not topic.format
        format: Literal["png", "jpeg"] = topic.format or "png"
        self._out = await environment.publisher(
            topic.to or topic.topic, topic.type, qos=topic.qos, raw=raw, format=format
        )
        await self.join(local, SubscriberInterface, topic.type, topic.topic, topic.qos)

    def send(self, message: Message, keep: int | None) -> int:
        if not self._pace.due():
            return 0
        try:
            value = self._filter(message.payload) if self._filter else message.payload
        except ConversionError as error:
            self._complain(self._topic.topic, error)
            return 0
        if value is None:
            return 0
        before = self._out.dropped
        self._out.offer(bytes(value), keep or 1)
        return self._out.dropped - before


class ReceivedTopic(Flow):
    """A topic of the environment that is published at the robot too."""

    def __init__(self, topic: Topic, filter: Filter | None = None) -> None:
        super().__init__()
        self._topic = topic
        self._filter = filter or (from_picture() if topic.format else None)
        self._pace = Pace(topic.rate)
        self._complain = _Complaints()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        topic = self._topic
        await self.join(local, PublisherInterface, topic.type, topic.to or topic.topic, topic.qos)
        format: Literal["png", "jpeg"] = topic.format or "png"
        await environment.subscriber(
            topic.topic,
            topic.type,
            callback=self._take,
            depth=topic.qos.depth,
            qos=topic.qos,
            raw=not topic.format,
            format=format,
        )

    def _take(self, value: Buffer) -> None:
        if not self._pace.due():
            return
        try:
            payload = self._filter(value) if self._filter else value
        except ConversionError as error:
            self._complain(self._topic.topic, error)
            return
        if payload is not None:
            self.deliver(Message(CLOUD, "", payload))


class OfferedService(Flow):
    """A service of the robot that nodes of the environment may call."""

    def __init__(self, service: Service) -> None:
        super().__init__()
        self._service = service
        self._calls: dict[str, asyncio.Future[bytes]] = {}

    async def open(self, local: LocalRos, environment: Environment) -> None:
        service = self._service
        await self.join(local, ServiceClientInterface, service.type, service.service)
        await environment.service_provider(service.to or service.service, service.type, self._ask, raw=True)

    async def _ask(self, request: Buffer) -> bytes:
        name = uuid.uuid4().hex
        answer = self._calls[name] = asyncio.get_running_loop().create_future()
        try:
            self.deliver(Message(CLOUD, name, request))
            response: bytes = await answer
            return response
        finally:
            del self._calls[name]

    def send(self, message: Message, keep: int | None) -> int:
        """An answer of the robot's service."""
        answer = self._calls.get(message.msg_id)
        if answer is not None and not answer.done():
            if message.error:
                answer.set_exception(error_of(message))
            else:
                answer.set_result(bytes(message.payload))
        return 0


class CalledService(Flow):
    """A service of the environment that nodes of the robot may call."""

    def __init__(self, service: Service) -> None:
        super().__init__()
        self._service = service
        self._tasks: set[asyncio.Task[None]] = set()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        service = self._service
        self._client = await environment.service_client(service.service, service.type, raw=True)
        await self.join(local, ServiceProviderInterface, service.type, service.to or service.service)

    def send(self, message: Message, keep: int | None) -> int:
        """A request of a node of the robot."""
        task = asyncio.create_task(self._call(message))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return 0

    async def _call(self, request: Message) -> None:
        try:
            answer: Any = await self._client.call(bytes(request.payload), TIMEOUT)
        except RceError as error:
            self.deliver(Message(CLOUD, request.msg_id, msgspec.msgpack.encode(error.info), error=True))
        else:
            self.deliver(Message(CLOUD, request.msg_id, answer))

    def end(self) -> None:
        for task in self._tasks:
            task.cancel()
        super().end()


def flows(config: BridgeConfig) -> Iterator[Flow]:
    """All that a bridge carries."""
    for topic in config.send.topics:
        yield SentTopic(topic)
    for topic in config.receive.topics:
        yield ReceivedTopic(topic)
    for service in config.send.services:
        yield OfferedService(service)
    for service in config.receive.services:
        yield CalledService(service)
    for kind, transforms in ((SentTopic, config.send.tf), (ReceivedTopic, config.receive.tf)):
        if transforms is not None:
            yield kind(Topic("/tf", TF_TYPE, qos=TF), _choose(transforms))
            yield kind(Topic("/tf_static", TF_TYPE, qos=STATIC), _choose(Transforms(transforms.frames)))


def _choose(transforms: Transforms) -> Filter:
    return chosen_transforms(transforms.frames, transforms.rate)

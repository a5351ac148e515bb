"""Flows of topics and services of a bridge, and the flows that a configuration asks for."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Iterator
from typing import Any, Literal

import msgspec
from twisted.logger import Logger

from endpoints.bridge.config import BridgeConfig, Service, Topic, Transforms
from endpoints.bridge.filters import Filter, RateLimit, image_decoder, image_encoder, transform_filter
from endpoints.bridge.flow import Flow
from endpoints.bridge.goals import CalledAction, OfferedAction
from endpoints.bridge.local_ros import CLOUD, LocalRos
from endpoints.data.frames import Message
from endpoints.data.interface import error_of
from endpoints.environment.service_calls import TIMEOUT
from endpoints.environment.services import ServiceClientInterface, ServiceProviderInterface
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from rce.client import Environment, Store
from rce.errors import ConversionError, RceError
from rce.net.outbox import Owner
from rce.protocol.blobs import Buffer
from rce.protocol.messages import Qos

TF_TYPE = "tf2_msgs/TFMessage"
STATIC = Qos(reliability="reliable", durability="transient_local", depth=100)
TF = Qos(depth=100)

log = Logger()


class _ErrorLog:
    """Logs each error text once."""

    def __init__(self) -> None:
        self._logged: set[str] = set()

    def warn(self, topic: str, error: RceError) -> None:
        """Log an error, unless the same text was logged before."""
        if str(error) not in self._logged:
            self._logged.add(str(error))
            log.warn("{topic}: {error}", topic=topic, error=str(error))


class SentTopic(Flow):
    """A topic of the robot that is also published in the environment."""

    def __init__(self, topic: Topic, filter: Filter | None = None) -> None:
        super().__init__()
        self._topic = topic
        self._filter = filter or (image_encoder(topic.format) if topic.format else None)
        self._rate_limit = RateLimit(topic.rate)
        self._errors = _ErrorLog()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Create the interfaces at both ends."""
        topic = self._topic
        raw = not topic.format
        format: Literal["png", "jpeg"] = topic.format or "png"
        self._out = await environment.publisher(
            topic.to or topic.topic,
            topic.type,
            qos=topic.qos,
            raw=raw,
            format=format,
            offline=Store(topic.store) if topic.offline == "store" else topic.offline,
        )
        await self.add_local_interface(local, SubscriberInterface, topic.type, topic.topic, topic.qos)

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Filter a message of the robot and publish it in the environment; return the number of dropped ones."""
        if not self._rate_limit.allows():
            return 0
        try:
            value = self._filter(message.payload) if self._filter else message.payload
        except ConversionError as error:
            self._errors.warn(self._topic.topic, error)
            return 0
        if value is None:
            return 0
        before = self._out.dropped
        self._out.offer(bytes(value), keep or 1)
        return self._out.dropped - before


class ReceivedTopic(Flow):
    """A topic of the environment that is also published at the robot."""

    def __init__(self, topic: Topic, filter: Filter | None = None) -> None:
        super().__init__()
        self._topic = topic
        self._filter = filter or (image_decoder() if topic.format else None)
        self._rate_limit = RateLimit(topic.rate)
        self._errors = _ErrorLog()

    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Create the interfaces at both ends."""
        topic = self._topic
        await self.add_local_interface(local, PublisherInterface, topic.type, topic.to or topic.topic, topic.qos)
        format: Literal["png", "jpeg"] = topic.format or "png"
        await environment.subscriber(
            topic.topic,
            topic.type,
            callback=self._receive,
            depth=topic.qos.depth,
            qos=topic.qos,
            raw=not topic.format,
            format=format,
        )

    def _receive(self, value: Buffer) -> None:
        if not self._rate_limit.allows():
            return
        try:
            payload = self._filter(value) if self._filter else value
        except ConversionError as error:
            self._errors.warn(self._topic.topic, error)
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
        """Create the interfaces at both ends."""
        service = self._service
        await self.add_local_interface(local, ServiceClientInterface, service.type, service.service)
        await environment.service_provider(service.to or service.service, service.type, self._call, raw=True)

    async def _call(self, request: Buffer) -> bytes:
        name = uuid.uuid4().hex
        answer = self._calls[name] = asyncio.get_running_loop().create_future()
        try:
            self.deliver(Message(CLOUD, name, request))
            response: bytes = await answer
            return response
        finally:
            del self._calls[name]

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Complete a call with the response of the robot's service."""
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
        """Create the interfaces at both ends."""
        service = self._service
        self._client = await environment.service_client(service.service, service.type, raw=True)
        await self.add_local_interface(local, ServiceProviderInterface, service.type, service.to or service.service)

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        """Call the service of the environment for a node of the robot."""
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
        """Cancel all calls and remove the interface."""
        for task in self._tasks:
            task.cancel()
        super().end()


def make_flows(config: BridgeConfig) -> Iterator[Flow]:
    """Yield all flows of a bridge, not open yet."""
    for topic in config.send.topics:
        yield SentTopic(topic)
    for topic in config.receive.topics:
        yield ReceivedTopic(topic)
    for service in config.send.services:
        yield OfferedService(service)
    for service in config.receive.services:
        yield CalledService(service)
    for action in config.send.actions:
        yield OfferedAction(action)
    for action in config.receive.actions:
        yield CalledAction(action)
    for kind, transforms in ((SentTopic, config.send.tf), (ReceivedTopic, config.receive.tf)):
        if transforms is not None:
            yield kind(Topic("/tf", TF_TYPE, qos=TF), _tf_filter(transforms))
            yield kind(Topic("/tf_static", TF_TYPE, qos=STATIC), _tf_filter(Transforms(transforms.frames)))


def _tf_filter(transforms: Transforms) -> Filter:
    return transform_filter(transforms.frames, transforms.rate)

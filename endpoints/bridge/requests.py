"""What nodes of the robot may ask the bridge for, by ids of its file: the cloud requests of RoboWS's Cloud IF node.

A request comes as a `std_msgs/String` on `/cloud_request` (its id) or as a call of the service `/cloud/ID`
(`std_srvs/Trigger`). What becomes of it is said on `/cloud_response`, as JSON in a `std_msgs/String`:
`{"id": …, "state": "accepted" | "done" | "failed", "message": …}`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping

import msgspec
from msgspec import Struct
from twisted.logger import Logger

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.config import Action
from endpoints.bridge.ends import CLOUD, CloudEnd, LocalRos
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.services import ServiceProviderInterface
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from endpoints.frames import Message
from rce.errors import NotFound, RceError
from rce.messages import Qos
from rce.names import parse_type

REQUESTS, RESPONSES, SERVICES = "/cloud_request", "/cloud_response", "/cloud"
STRING, TRIGGER = "std_msgs/String", "std_srvs/Trigger"
RELIABLE = Qos(reliability="reliable", depth=10)

log = Logger()
Perform = Callable[[Action], Awaitable[str]]
"""Does what a request asks for; returns a sentence about what was done, raises RceError."""


class Response(Struct, frozen=True):
    """What is said on `/cloud_response`."""

    id: str
    state: str
    message: str = ""


class Desk:
    """Takes requests and says what becomes of them."""

    def __init__(self, actions: Mapping[str, Action], perform: Perform) -> None:
        self._actions = actions
        self._perform = perform
        self._tasks: set[asyncio.Task[None]] = set()
        self._say: RosInterface
        self._codec = TypeRegistry().message(parse_type(STRING))

    async def open(self, local: LocalRos) -> None:
        self._say = await local.interface(PublisherInterface, STRING, RESPONSES, CloudEnd(), RELIABLE)
        await local.interface(SubscriberInterface, STRING, REQUESTS, _RequestTopic(self), RELIABLE)
        for name in self._actions:
            service = _RequestService(self, name)
            service.near = await local.interface(ServiceProviderInterface, TRIGGER, f"{SERVICES}/{name}", service)

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()

    def take(self, cdr: bytes) -> None:
        """A request of the topic."""
        name = msgspec.json.decode(self._codec.decode(cdr).raw)["data"].strip()
        self.begin(self._answer(name))

    def begin(self, work: Awaitable[None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def carry_out(self, name: str) -> str:
        """Raises RceError."""
        action = self._actions.get(name)
        if action is None:
            raise NotFound(f"no request has the id {name[:80]!r}; there are: {', '.join(self._actions) or 'none'}")
        self.say(Response(name, "accepted"))
        return await self._perform(action)

    async def _answer(self, name: str) -> None:
        try:
            self.say(Response(name, "done", await self.carry_out(name)))
        except RceError as error:
            log.warn("request {name}: {error}", name=name, error=str(error))
            self.say(Response(name, "failed", str(error)))

    def say(self, response: Response) -> None:
        text = msgspec.json.encode({"data": msgspec.json.encode(response).decode()})
        self._say.receive(Message(CLOUD, "", self._codec.encode(Wire(False, text, {}))), CloudEnd())


class _RequestTopic(CloudEnd):
    def __init__(self, desk: Desk) -> None:
        super().__init__()
        self._desk = desk

    def send(self, message: Message, keep: int | None) -> int:
        self._desk.take(bytes(message.payload))
        return 0


class _RequestService(CloudEnd):
    def __init__(self, desk: Desk, name: str) -> None:
        super().__init__()
        self.near: RosInterface
        self._desk = desk
        self._name = name
        self._codec = TypeRegistry().service(parse_type(TRIGGER)).response

    def send(self, message: Message, keep: int | None) -> int:
        self._desk.begin(self._answer(message))
        return 0

    async def _answer(self, request: Message) -> None:
        try:
            good, sentence = True, await self._desk.carry_out(self._name)
        except RceError as error:
            good, sentence = False, str(error)
        self._desk.say(Response(self._name, "done" if good else "failed", sentence))
        text = msgspec.json.encode({"success": good, "message": sentence})
        self.near.receive(Message(CLOUD, request.msg_id, self._codec.encode(Wire(False, text, {}))), self)

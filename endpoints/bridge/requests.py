"""Requests of nodes on the robot, by ids of the configuration: the cloud requests of RoboWS's Cloud IF node.

A request is a `std_msgs/String` with the id on `/cloud_request`, or a call of the service `/cloud/ID`
(`std_srvs/Trigger`). Its progress is published on `/cloud_response`, as JSON in a `std_msgs/String`:
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
from endpoints.bridge.local_ros import CLOUD, CloudLink, LocalRos
from endpoints.data.frames import Message
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.services import ServiceProviderInterface
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from rce.errors import ConversionError, InternalError, NotFound, RceError
from rce.net.outbox import Owner
from rce.protocol.messages import Qos
from rce.protocol.names import parse_type

REQUESTS, RESPONSES, SERVICES = "/cloud_request", "/cloud_response", "/cloud"
STRING, TRIGGER = "std_msgs/String", "std_srvs/Trigger"
RELIABLE = Qos(reliability="reliable", depth=10)

log = Logger()
Perform = Callable[[Action], Awaitable[str]]
"""Executes an action; returns a sentence about the result, or raises RceError."""


class Response(Struct, frozen=True):
    """Message on `/cloud_response`."""

    id: str
    state: str
    message: str = ""


class RequestServer:
    """Executes requests and publishes their progress."""

    def __init__(self, actions: Mapping[str, Action], perform: Perform) -> None:
        self._actions = actions
        self._perform = perform
        self._tasks: set[asyncio.Task[None]] = set()
        self._responses: RosInterface
        self._codec = TypeRegistry().message(parse_type(STRING))

    async def open(self, local: LocalRos) -> None:
        """Create the topics and services."""
        self._responses = await local.add_interface(PublisherInterface, STRING, RESPONSES, CloudLink(), RELIABLE)
        await local.add_interface(SubscriberInterface, STRING, REQUESTS, _RequestTopic(self), RELIABLE)
        for name in self._actions:
            service = _RequestService(self, name)
            service.interface = await local.add_interface(
                ServiceProviderInterface, TRIGGER, f"{SERVICES}/{name}", service
            )

    def close(self) -> None:
        """Cancel the requests that are in progress."""
        for task in self._tasks:
            task.cancel()

    def request_received(self, cdr: bytes) -> None:
        """Start a request that came on the topic; one that is not a valid string fails."""
        try:
            name = msgspec.json.decode(self._codec.decode(cdr).raw)["data"].strip()
        except ConversionError as error:
            self._failed("", error)
        else:
            self.start(self._answer(name))

    def start(self, work: Awaitable[None]) -> None:
        """Run `work` as a task that `close` cancels."""
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def execute(self, name: str) -> str:
        """Execute the request with this id; return a sentence about the result.

        Raises:
            NotFound: There is no such request.
            RceError: The action failed.
        """
        action = self._actions.get(name)
        if action is None:
            raise NotFound(
                f"there is no request {name[:80]!r}; the configuration has: {', '.join(self._actions) or 'none'}"
            )
        self.publish(Response(name, "accepted"))
        try:
            return await self._perform(action)
        except RceError:
            raise
        except Exception as error:  # noqa: BLE001  # a defect; who asked waits for an answer
            log.failure("request {name} failed", name=name)
            raise InternalError(f"request {name} failed: {error!r}; the log of the bridge tells more") from None

    async def _answer(self, name: str) -> None:
        try:
            self.publish(Response(name, "done", await self.execute(name)))
        except RceError as error:
            self._failed(name, error)

    def _failed(self, name: str, error: RceError) -> None:
        log.warn("request {name} failed: {error}", name=name, error=str(error))
        self.publish(Response(name, "failed", str(error)))

    def publish(self, response: Response) -> None:
        """Publish a response."""
        text = msgspec.json.encode({"data": msgspec.json.encode(response).decode()})
        self._responses.receive(Message(CLOUD, "", self._codec.encode(Wire(False, text, {}))), CloudLink())


class _RequestTopic(CloudLink):
    """Link that receives the requests of the topic."""

    def __init__(self, server: RequestServer) -> None:
        super().__init__()
        self._server = server

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        self._server.request_received(bytes(message.payload))
        return 0


class _RequestService(CloudLink):
    """Link that receives the calls of one service."""

    def __init__(self, server: RequestServer, name: str) -> None:
        super().__init__()
        self.interface: RosInterface
        self._server = server
        self._name = name
        self._codec = TypeRegistry().service(parse_type(TRIGGER)).response

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        self._server.start(self._answer(message))
        return 0

    async def _answer(self, request: Message) -> None:
        try:
            success, message = True, await self._server.execute(self._name)
        except RceError as error:
            success, message = False, str(error)
        self._server.publish(Response(self._name, "done" if success else "failed", message))
        text = msgspec.json.encode({"success": success, "message": message})
        self.interface.receive(Message(CLOUD, request.msg_id, self._codec.encode(Wire(False, text, {}))), self)

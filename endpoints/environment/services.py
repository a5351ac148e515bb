"""The service interfaces of an environment: many requests at a time, each with a time limit."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from uuid import uuid4

from endpoints.environment.interfaces import RosInterface, Surroundings, raw
from endpoints.environment.ros_services import Header, RawClient, RawService
from endpoints.environment.ros_topics import SETTLING
from endpoints.environment.ros_types import service_class
from endpoints.frames import Message
from endpoints.interface import MAX_REQUESTS, error_of
from endpoints.link import Link
from rce.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, LimitExceeded, NotConnected, NotFound, RceError, TimedOut

TIMEOUT = 30.0  # seconds that an answer may take
APPEAR = 5.0  # seconds that a request waits for its service to appear
IN_FLIGHT = 8  # ROS 2 servers keep 10 requests that they have not taken up; what comes beyond these is lost


@dataclass
class _Request:
    message: Message
    since: float


class ServiceClientInterface(RosInterface):
    """Calls a ROS service for its peers. A peer gets the response, or an error."""

    _client: RawClient

    def __init__(self, spec: InterfaceSpec, around: Surroundings) -> None:
        super().__init__(spec, around)
        self._unanswered = 0  # the rest belongs to the ROS thread
        self._waiting: deque[_Request] = deque()
        self._asked: dict[int, _Request] = {}
        self._settled = self._settling = False

    async def open(self) -> None:
        kind = service_class(self.spec.type, self._around.definitions)
        self._client = await self._make(lambda: RawClient(self._ros, kind, self.spec.addr, self._answered))

    def receive(self, message: Message, link: Link) -> None:
        self._unanswered += 1
        if self._unanswered > MAX_REQUESTS:
            self._refuse(message, LimitExceeded(f"{self._named} has {MAX_REQUESTS} requests that wait for an answer"))
        else:
            self._ros.post(lambda: self._accept(_Request(message, time.monotonic())))

    def tick(self, now: float) -> None:
        self._ros.post(lambda: self._expire(now))

    def close(self) -> None:
        self._ros.post(self._end)

    @property
    def _named(self) -> str:
        return f"interface {self.spec.tag}: service {self.spec.addr}"

    # in the ROS thread

    def _accept(self, request: _Request) -> None:
        self._waiting.append(request)
        self._send()

    def _send(self) -> None:
        while self._waiting and len(self._asked) < IN_FLIGHT:
            if not self._client.available():
                self._settled = False
                self._wait_for_service()
                return
            if not self._settled:
                self._settle()
                return
            request = self._waiting.popleft()
            try:
                self._asked[self._client.ask(raw(request.message.payload))] = request
                self.watch.ended(self.id, request.message)
            except ConversionError as error:
                self._fail(request, error)

    def _settle(self) -> None:
        """A server that has just been found may not have found us: its answers of this moment would be lost."""
        if not self._settling:
            self._settling = True
            self._ros.later(SETTLING, self._go_on)

    def _go_on(self) -> None:
        self._settling, self._settled = False, True
        self._send()

    def _wait_for_service(self) -> None:
        while self._waiting and self._waiting[0].since + APPEAR < time.monotonic():
            self._fail(self._waiting.popleft(), NotFound(f"{self._named} has not appeared in {APPEAR:g} s"))
        self._ros.again(self._send)

    def _answered(self, number: int, payload: bytes) -> None:
        request = self._asked.pop(number, None)
        if request is not None:  # else it came too late
            since = time.perf_counter()
            self._ros.deliver(lambda: self._respond(request.message, payload, since))
            self._send()

    def _expire(self, now: float) -> None:
        late = [number for number, request in self._asked.items() if request.since + TIMEOUT < now]
        for number in late:
            self._fail(self._asked.pop(number), TimedOut(f"{self._named} has not answered in {TIMEOUT:g} s"))
        while self._waiting and self._waiting[0].since + TIMEOUT < now:
            self._fail(self._waiting.popleft(), TimedOut(f"{self._named} was busy for {TIMEOUT:g} s"))
        self._send()

    def _end(self) -> None:
        self._waiting.clear()
        self._asked.clear()
        self._ros.unwatch(self._client)

    def _fail(self, request: _Request, error: RceError) -> None:
        self._ros.deliver(lambda: self._refuse(request.message, error))

    # in the loop

    def _respond(self, request: Message, payload: bytes, since: float) -> None:
        self._unanswered -= 1
        if request.source in self.peers:
            try:
                answer = Message(self.id, request.msg_id, payload, destination=request.source, since=since)
                self.request(answer)
            except LimitExceeded as error:
                self._complain(error)

    def _refuse(self, request: Message, error: RceError) -> None:
        self._unanswered -= 1
        try:
            self.fail(request, error)
        except LimitExceeded as full:
            self._complain(full)


class ServiceProviderInterface(RosInterface):
    """Offers a ROS service that its one peer answers.

    ROS services cannot fail: a node whose request fails gets no answer, and the owner of the interface is told why.
    """

    _service: RawService

    def __init__(self, spec: InterfaceSpec, around: Surroundings) -> None:
        super().__init__(spec, around)
        self._asked: dict[str, tuple[Header, float]] = {}  # by message id

    async def open(self) -> None:
        kind = service_class(self.spec.type, self._around.definitions)
        self._service = await self._make(
            lambda: RawService(
                self._ros,
                kind,
                self.spec.addr,
                lambda header, payload: self._ros.deliver(lambda: self._ask(header, payload)),
            )
        )

    def _ask(self, header: Header, payload: bytes) -> None:
        name = uuid4().hex
        self._asked[name] = header, time.monotonic() + TIMEOUT
        try:
            self.request(Message(self.id, name, payload))
        except (NotConnected, LimitExceeded) as error:
            del self._asked[name]
            self._failed(error)

    def receive(self, message: Message, link: Link) -> None:
        header, _ = self._asked.pop(message.msg_id, (None, 0))
        if header is None:
            self._failed(NotFound("it is not known, or was answered already, or the answer came too late"))
        elif message.error:
            self._failed(error_of(message))
        else:
            self._ros.post(lambda: self._answer(header, message))

    def _answer(self, header: Header, message: Message) -> None:
        """In the ROS thread."""
        try:
            self._service.answer(header, raw(message.payload))
            self.watch.ended(self.id, message)
        except ConversionError as error:
            self._complain_from_ros(ConversionError, str(error))

    def _failed(self, error: RceError) -> None:
        self._complain(type(error)(f"interface {self.spec.tag}: a request to {self.spec.addr} failed: {error}"))

    def stopped(self) -> None:
        if self._asked:
            self._failed(NotConnected(f"the connection went with {len(self._asked)} requests unanswered"))
            self._asked.clear()

    def tick(self, now: float) -> None:
        late = [name for name, (_, until) in self._asked.items() if until < now]
        for name in late:
            del self._asked[name]
            self._failed(TimedOut(f"no answer in {TIMEOUT:g} s"))

    def close(self) -> None:
        self._ros.post(lambda: self._ros.unwatch(self._service))

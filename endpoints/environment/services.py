"""Service interfaces of an environment; each request has a timeout."""

from __future__ import annotations

import time
from uuid import uuid4

from endpoints.data.frames import Message
from endpoints.data.interface import MAX_REQUESTS, error_of
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface, as_bytes
from endpoints.environment.ros_services import Header, RawService, ServiceType
from endpoints.environment.ros_types import service_class
from endpoints.environment.service_calls import TIMEOUT, ServiceCall, ServiceCaller
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, LimitExceeded, NotConnected, NotFound, RceError, TimedOut
from rce.net.budget import INTERFACE, MB


class ServiceClientInterface(RosInterface):
    """Calls a ROS service for its peers, which get the response or an error."""

    _caller: ServiceCaller

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._unanswered = self._unanswered_size = 0

    async def open(self) -> None:
        """Create the ROS entity."""
        kind = service_class(self.spec.type, self._context.definitions)
        self._caller = self._create(lambda: self._create_caller(kind))

    def _create_caller(self, kind: ServiceType) -> ServiceCaller:
        name = self.spec.addr
        return ServiceCaller(self._ros, kind, name, self._label, self._context.slots.of(name))

    def receive(self, message: Message, link: Link) -> None:
        """Queue a request, or refuse it when too many are unanswered."""
        self._unanswered += 1
        self._unanswered_size += len(message.payload)
        if self._unanswered > MAX_REQUESTS or (self._unanswered > 1 and self._unanswered_size > INTERFACE):
            most = f"{MAX_REQUESTS} unanswered requests, or {INTERFACE // MB} MB of them"
            self._refuse(message, LimitExceeded(f"{self._label} has {most}: send fewer"))
            return
        call = ServiceCall(
            as_bytes(message.payload),
            lambda answer: self._answered(message, answer),
            lambda: self.hops.delivered(self.id, message),
        )
        self._caller.call(call)

    def tick(self, now: float) -> None:
        """End requests that have timed out."""
        self._caller.expire(now)

    def close(self) -> None:
        """Destroy the client; its requests get no answer."""
        self._caller.destroy()

    @property
    def _label(self) -> str:
        return f"interface {self.spec.tag}: service {self.spec.addr}"

    def _answered(self, request: Message, answer: bytes | RceError) -> None:
        """Pass an answer on."""
        if isinstance(answer, RceError):
            self._refuse(request, answer)
            return
        since = time.perf_counter()
        self._answered_one(request)
        if request.source in self.peers:
            try:
                response = Message(self.id, request.msg_id, answer, destination=request.source, entered_at=since)
                self.request(response)
            except LimitExceeded as error:
                self._report_once(error)
                self.fail(request, error)

    def _answered_one(self, request: Message) -> None:
        self._unanswered -= 1
        self._unanswered_size -= len(request.payload)

    def _refuse(self, request: Message, error: RceError) -> None:
        self._answered_one(request)
        try:
            self.fail(request, error)
        except LimitExceeded as full:
            self._report_once(full)


class ServiceProviderInterface(RosInterface):
    """Offers a ROS service that its peer answers.

    ROS services cannot return errors: when a request fails, the calling node gets no response, and the error is
    reported to the owner of the interface.
    """

    _service: RawService

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self._requests: dict[str, tuple[Header, float]] = {}  # unanswered, by message id, with their deadlines

    async def open(self) -> None:
        """Create the ROS entity."""
        kind = service_class(self.spec.type, self._context.definitions)
        self._service = self._create(
            lambda: RawService(self._ros, kind, self.spec.addr, self._forward, self._report_from_ros)
        )

    def _forward(self, header: Header, payload: bytes) -> None:
        name = uuid4().hex
        self._requests[name] = header, time.monotonic() + TIMEOUT
        try:
            self.request(Message(self.id, name, payload))
        except (NotConnected, LimitExceeded) as error:
            del self._requests[name]
            self._request_failed(error)

    def receive(self, message: Message, link: Link) -> None:
        """Send the response of the peer to the calling node, or report its error."""
        header, _ = self._requests.pop(message.msg_id, (None, 0))
        if header is None:
            self._request_failed(NotFound("the response belongs to no request, or came too late, or is the second one"))
        elif message.error:
            self._request_failed(error_of(message))
        else:
            self._respond(header, message)

    def _respond(self, header: Header, message: Message) -> None:
        """Send a response."""
        try:
            self._service.answer(header, as_bytes(message.payload))
            self.hops.delivered(self.id, message)
        except ConversionError as error:
            self._report_from_ros(ConversionError, str(error))

    def _request_failed(self, error: RceError) -> None:
        self._report_once(type(error)(f"interface {self.spec.tag}: a request to {self.spec.addr} failed: {error}"))

    def stopped(self) -> None:
        """Report the requests that the last peer has left unanswered."""
        if self._requests:
            self._request_failed(NotConnected(f"the connection ended with {len(self._requests)} requests unanswered"))
            self._requests.clear()

    def tick(self, now: float) -> None:
        """Report requests that have timed out."""
        late = [name for name, (_, until) in self._requests.items() if until < now]
        for name in late:
            del self._requests[name]
            self._request_failed(TimedOut(f"no response within {TIMEOUT:g} s"))

    def close(self) -> None:
        """Destroy the server."""
        self._service.destroy()

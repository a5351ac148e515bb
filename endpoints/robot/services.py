"""Services of robots: a `ServiceClient` calls a service of the robot, a `ServiceProvider` one of the cloud."""

from __future__ import annotations

import asyncio
import uuid
from time import perf_counter

from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import error_of
from endpoints.data.link import Link
from endpoints.robot.conversion import Outgoing
from endpoints.robot.formats import Codecs
from endpoints.robot.interfaces import RobotInterface
from endpoints.robot.session import RobotSession
from endpoints.robot.workers import Workers
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, RceError, TimedOut
from rce.protocol.blobs import Buffer
from rce.protocol.messages import DataMessage

MAX_PENDING = 1000  # unanswered calls of one interface


class ServiceInterface(RobotInterface):
    """Base of both sides of a service: keeps the unanswered calls and their timeouts."""

    def __init__(
        self,
        spec: InterfaceSpec,
        hops: HopRecorder,
        session: RobotSession,
        workers: Workers,
        request: Codecs,
        response: Codecs,
        timeout: float,
    ) -> None:
        super().__init__(spec, hops, session, workers)
        self._request = request
        self._response = response
        self._timeout = timeout
        self._waiting: dict[str, tuple[Message, asyncio.TimerHandle]] = {}

    def timed_out(self, call: Message) -> None:
        """Handle a call that was not answered in time."""
        raise NotImplementedError

    def peer_lost(self, call: Message) -> None:
        """Handle an unanswered call when the last peer is gone."""
        raise NotImplementedError

    def check_room(self) -> None:
        """Raise LimitExceeded if too many bytes wait for the robot to take another message."""
        if self.budget.full and self.backlog():
            raise LimitExceeded(
                f"interface {self.spec.tag}: too many bytes wait for robot {self.spec.owner} already: "
                "send fewer or smaller messages at a time"
            )

    def _add_call(self, name: str, call: Message) -> None:
        """Keep an unanswered call; raise LimitExceeded when there are too many."""
        if len(self._waiting) >= MAX_PENDING:
            raise LimitExceeded(f"interface {self.spec.tag} has {MAX_PENDING} unanswered calls: wait for their answers")
        timer = asyncio.get_running_loop().call_later(self._timeout, self._expire, name)
        self._waiting[name] = (call, timer)

    def _pop_call(self, name: str) -> Message | None:
        """Remove and return the unanswered call of this name; None if there is none."""
        call, timer = self._waiting.pop(name, (None, None))
        if timer is not None:
            timer.cancel()
        return call

    def _expire(self, name: str) -> None:
        call = self._pop_call(name)
        if call is not None:
            self.timed_out(call)

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more, and end the unanswered calls."""
        super().stopped()
        for name in list(self._waiting):
            call = self._pop_call(name)
            if call is not None:
                self.peer_lost(call)


class ServiceClient(ServiceInterface):
    """Passes service calls from the cloud to the robot, which answers them."""

    def receive(self, message: Message, link: Link) -> None:
        """Send a request to the robot under a message id of its own."""
        name = uuid.uuid4().hex
        try:
            self.check_room()
            self._add_call(name, Message(message.source, message.msg_id, b""))  # the payload is not needed any more
        except LimitExceeded as error:
            self.fail(message, error)
            return
        self.to_robot(self._request(), name, message, None)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Send the robot's response, or its error, to the interface that made the call."""
        since = perf_counter()
        request = self._pop_call(message.msgID)
        if request is None:
            raise NotConnected(
                f"interface {self.spec.tag}: there is no unanswered call with msgID {message.msgID[:64]!r}; "
                "it may have timed out",
                field="msgID",
            )
        if message.error:
            self.fail(request, RceError(f"{self.spec.owner}/{self.spec.tag}: {message.error}"))
            return None

        def answer(cdr: Buffer) -> None:
            self.request(Message(self.id, request.msg_id, cdr, destination=request.source, entered_at=since))

        try:
            task = self._from_robot.convert(self._response(), self.wire(message, blobs), answer)
        except RceError as error:
            self.fail(request, error)
            raise
        if task is not None:
            task.add_done_callback(lambda done: self._fail_with(request, done))
        return task

    def _fail_with(self, request: Message, done: asyncio.Task[None]) -> None:
        """Fail a call whose answer could not be converted."""
        if not done.cancelled() and isinstance(error := done.exception(), RceError):
            self.fail(request, error)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Answer the call with the error."""
        for name, (request, _) in self._waiting.items():
            if request.source == outgoing.message.source and request.msg_id == outgoing.message.msg_id:
                self._pop_call(name)
                self.fail(request, error)
                break
        super().undelivered(outgoing, error)

    def timed_out(self, call: Message) -> None:
        """Answer the call with an error."""
        self.fail(call, TimedOut(f"robot {self.spec.owner} did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Do nothing: the interface that made the call is gone."""


class ServiceProvider(ServiceInterface):
    """Passes service calls from the robot to the cloud, which answers them."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Send a request of the robot to the service."""
        self._check_new(message.msgID)
        since = perf_counter()
        wire, codec = self.wire(message, blobs), self._request()
        if not self.peers and not codec.encodes_fast(wire):
            self._call(message.msgID, b"", since)  # nobody gets it, so it is not converted
            return None
        return self._from_robot.convert(codec, wire, lambda cdr: self._call(message.msgID, cdr, since))

    def _check_new(self, msg_id: str) -> None:
        if msg_id in self._waiting:
            raise InvalidRequest(
                f"interface {self.spec.tag} has an unanswered call with this msgID: use a new one", field="msgID"
            )

    def _call(self, msg_id: str, payload: Buffer, since: float) -> None:
        self._check_new(msg_id)  # again: another may have come while this one was converted
        request = Message(self.id, msg_id, payload, entered_at=since)
        # Before the request leaves: a peer in this process may answer at once.
        self._add_call(msg_id, Message(self.id, msg_id, b""))
        try:
            self.request(request)
        except RceError:
            self._pop_call(msg_id)
            raise

    def receive(self, message: Message, link: Link) -> None:
        """Send a response, or an error, to the robot."""
        if self._pop_call(message.msg_id) is None:
            return  # the call has timed out, and the robot got an error
        try:
            if message.error:
                raise error_of(message)
            self.check_room()
        except RceError as error:
            self._fail(message, error)
            return
        self.to_robot(self._response(), message.msg_id, message, None)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Send an error to the robot."""
        self._fail(outgoing.message, error.with_item(self.spec.tag))

    def timed_out(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, TimedOut(f"the service did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, NotConnected(f"interface {self.spec.tag} lost its connection before the answer came"))

    def _fail(self, call: Message, error: RceError) -> None:
        self.session.call_failed(self.spec.tag, call.msg_id, error)

"""Interfaces of a robot for actions: it asks for goals by an ActionProvider, and is asked for them by an ActionClient.

The `msgID` of all messages of a goal is its id, which the asker has chosen; `phase` says what a message means.
"""

from __future__ import annotations

import asyncio
from time import perf_counter
from typing import NamedTuple, cast

from msgspec import UNSET

from converters import Recipe, Wire
from converters.reduction import AnyCodec as Codec
from endpoints.data.frames import Message, Phase
from endpoints.data.goals import MAX_FEEDBACK, MAX_GOALS, Goals, check_goal_id
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import error_of
from endpoints.data.link import Link
from endpoints.robot.conversion import Outgoing
from endpoints.robot.formats import Codecs
from endpoints.robot.interfaces import RobotInterface
from endpoints.robot.session import RobotSession
from endpoints.robot.workers import Workers
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, NotFound, RceError
from rce.protocol.blobs import Buffer
from rce.protocol.messages import DataMessage

STATUSES = {Phase.SUCCEEDED: "succeeded", Phase.CANCELED: "canceled", Phase.ABORTED: "aborted"}
ENDS = {status: phase for phase, status in STATUSES.items()}
EMPTY = Wire(False, b"{}", {})


class NoContent:
    """Codec of messages that have a phase only."""

    recipe = Recipe("", "json")  # for no worker

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True."""
        return True

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True."""
        return True

    def encode(self, wire: Wire) -> Buffer:
        """Return no bytes."""
        return b""

    def decode(self, cdr: Buffer) -> Wire:
        """Return the empty object."""
        return EMPTY


NO_CONTENT = NoContent()


class ActionCodecs(NamedTuple):
    """Codecs of an action."""

    goal: Codecs
    result: Codecs
    feedback: Codecs


class ActionInterface(RobotInterface):
    """Base of both sides of an action."""

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codecs: ActionCodecs
    ) -> None:
        super().__init__(spec, hops, session, workers)
        self._codecs = codecs

    def _send(self, phase: str, message: Message, codec: Codec = NO_CONTENT, status: str = "") -> None:
        """Queue a message for the robot."""
        more = b',"phase":"%b"' % phase.encode()
        if status:
            more += b',"status":"%b"' % status.encode()
        self.to_robot(codec, message.msg_id, message, None, more)

    def _content(self, message: DataMessage, blobs: dict[str, Buffer], codecs: Codecs) -> tuple[Codec, Wire]:
        """Return the codec and the value of a message; without a value that is the default, or empty."""
        if message.msg is not UNSET or message.blob is not UNSET:
            return codecs(), self.wire(message, blobs)
        return (NO_CONTENT if self.spec.kind.endswith("Forwarder") else codecs()), EMPTY


class ActionProvider(ActionInterface):
    """Sends the robot's goals to the cloud, and what becomes of them to the robot."""

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codecs: ActionCodecs
    ) -> None:
        super().__init__(spec, hops, session, workers, codecs)
        self._unfinished: set[str] = set()

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Send a goal, a request to cancel one, or a request for a result."""
        id, since = check_goal_id(message.msgID), perf_counter()
        if message.phase == "goal":
            phase = Phase.LEASED_GOAL if message.ifLost == "cancel" else Phase.GOAL
            codec, wire = self._content(message, blobs, self._codecs.goal)
        elif message.phase in ("cancel", "result"):
            phase = Phase.CANCEL if message.phase == "cancel" else Phase.RESULT
            codec, wire = NO_CONTENT, EMPTY
        else:
            raise InvalidRequest(
                f"interface {self.spec.tag}: phase must be goal, cancel or result, not {message.phase!r}", field="phase"
            )
        return self._from_robot.convert(
            codec, wire, lambda cdr: self._ask(Message(self.id, id, cdr, phase=phase, entered_at=since))
        )

    def _ask(self, message: Message) -> None:
        known, cancel = message.msg_id in self._unfinished, message.phase == Phase.CANCEL
        if not cancel:
            if known and message.phase != Phase.RESULT:
                raise InvalidRequest(f"interface {self.spec.tag} has this goal already: use a new id", field="msgID")
            if not known and len(self._unfinished) >= MAX_GOALS:
                raise LimitExceeded(f"interface {self.spec.tag} has {MAX_GOALS} unfinished goals: wait for their ends")
            self._unfinished.add(message.msg_id)  # before it leaves: a peer in this process may answer at once
        try:
            self.request(message)
        except RceError as error:
            if not (cancel or known):
                self._unfinished.discard(message.msg_id)
            raise (error.with_fields(phase="cancel") if cancel else error) from None

    def receive(self, message: Message, link: Link) -> None:
        """Tell the robot what became of a goal."""
        phase = message.phase
        if message.error:
            self._failed(message.msg_id, error_of(message), cancel=phase == Phase.CANCEL)
        elif phase == Phase.FEEDBACK:
            if self.backlog() >= MAX_FEEDBACK or (self.budget.full and self.backlog()):
                self.dropped += 1
                self.report_drops()
            else:
                self._send("feedback", message, self._codecs.feedback())
        elif phase in STATUSES:
            self._unfinished.discard(message.msg_id)
            codec = self._codecs.result() if message.payload else NO_CONTENT
            self._send("result", message, codec, STATUSES[phase])
        elif phase in (Phase.ACCEPTED, Phase.REJECTED, Phase.CANCEL):
            if phase == Phase.REJECTED:
                self._unfinished.discard(message.msg_id)
            self._send(phase.name.lower(), message)

    def _failed(self, id: str, error: RceError, *, cancel: bool = False) -> None:
        if not cancel:
            self._unfinished.discard(id)
        self.session.call_failed(self.spec.tag, id, error.with_fields(phase="cancel") if cancel else error)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Tell the robot that a message about a goal cannot be sent; without its result the goal has failed."""
        if outgoing.message.phase == Phase.FEEDBACK:
            super().undelivered(outgoing, error)
        else:
            self._failed(outgoing.message.msg_id, error.with_item(self.spec.tag))

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more, and end its goals."""
        super().stopped()
        for id in list(self._unfinished):
            self._failed(id, NotConnected(f"interface {self.spec.tag} lost its connection before the goal ended"))


class ActionClient(ActionInterface):
    """Passes goals of the cloud to the robot, which carries them out."""

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codecs: ActionCodecs
    ) -> None:
        super().__init__(spec, hops, session, workers, codecs)
        self._goals = Goals(self, self._start, self._cancel)

    def receive(self, message: Message, link: Link) -> None:
        """Handle a goal, or a request about one."""
        self._goals.receive(message)

    def left(self, peer: bytes) -> None:
        """Cancel the goals of the peer that shall not outlive it."""
        self._goals.left(peer)

    def close(self) -> None:
        """Forget the goals, and remove the interface from its session."""
        self._goals.close()
        super().close()

    def _start(self, message: Message) -> None:
        if self.budget.full and self.backlog():
            raise LimitExceeded(
                f"interface {self.spec.tag}: too many bytes wait for robot {self.spec.owner} already: "
                "send fewer or smaller goals at a time"
            )
        self._send("goal", message, self._codecs.goal())

    def _cancel(self, id: str) -> None:
        self._send("cancel", Message(self.id, id, b""))

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Pass on what became of a goal."""
        id = message.msgID
        if id not in self._goals:
            raise NotFound(f"interface {self.spec.tag} has no unfinished goal with msgID {id[:64]!r}", field="msgID")
        if message.error:
            error = RceError(f"{self.spec.owner}/{self.spec.tag}: {message.error}")
            if message.phase == "cancel":
                self._goals.not_canceled(id, error)
            else:
                self._goals.fail(id, error)
            return None
        phase = ENDS.get(message.status) if message.phase == "result" else _REPORTS.get(message.phase)
        if phase is None:
            raise InvalidRequest(
                f"interface {self.spec.tag}: phase must be accepted, rejected, feedback, cancel, or result with a "
                "status of succeeded, canceled or aborted",
                field="status" if message.phase == "result" else "phase",
            )
        codec, wire = cast(Codec, NO_CONTENT), EMPTY
        if message.phase in ("feedback", "result"):
            codecs = self._codecs.result if message.phase == "result" else self._codecs.feedback
            codec, wire = self._content(message, blobs, codecs)
        return self._from_robot.convert(codec, wire, lambda cdr: self._goals.answer(id, phase, cdr))

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """End a goal that cannot be sent to the robot."""
        self._goals.fail(outgoing.message.msg_id, error)
        super().undelivered(outgoing, error)


_REPORTS = {
    "accepted": Phase.ACCEPTED,
    "rejected": Phase.REJECTED,
    "feedback": Phase.FEEDBACK,
    "cancel": Phase.CANCEL,
}

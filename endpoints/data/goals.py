"""Goals of actions, at the interface that carries them out for its peers."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace

import msgspec
from twisted.logger import Logger

from endpoints.data.frames import Buffer, Message, Phase
from endpoints.data.interface import Interface
from rce.errors import AlreadyExists, InvalidRequest, LimitExceeded, NotConnected, NotFound, RceError
from rce.net.budget import MB, OVERHEAD

GOAL_ID = re.compile(r"[0-9a-f]{32}", re.ASCII)
MAX_GOALS = 1000  # unfinished goals of one interface
MAX_KEPT, MAX_KEPT_BYTES = 1000, 4 * MB  # results of one interface that are kept for askers that come back
MAX_FEEDBACK = 100  # messages of one interface that may wait for a link; further feedback is dropped
STARTS = (Phase.GOAL, Phase.LEASED_GOAL)

log = Logger()


def check_goal_id(id: str) -> str:
    """Return the id of a goal.

    Raises:
        InvalidRequest: It is not a UUID in 32 hex digits.
    """
    if not GOAL_ID.fullmatch(id):
        raise InvalidRequest(
            f"msgID {id[:64]!r} is not the id of a goal: it must be a UUID in 32 lower-case hex digits", field="msgID"
        )
    return id


@dataclass(slots=True)
class _Goal:
    """A goal that has not ended. `cancel` is true while it must be canceled as soon as it is accepted."""

    source: bytes
    leased: bool
    accepted: bool = False
    cancel: bool = False


class Goals:
    """Goals by their ids: who asked for each, and the results of those that ended.

    An asker that comes back under another interface asks for the result by the goal's id, and gets it then or when the
    goal ends.

    Args:
        interface: The interface, whose peers ask for goals.
        start: Carries out the goal of a message.
        cancel: Cancels the goal with this id, which was accepted.
    """

    droppable = True  # what is kept gives way to messages

    def __init__(self, interface: Interface, start: Callable[[Message], None], cancel: Callable[[str], None]) -> None:
        self._interface = interface
        self._start = start
        self._cancel = cancel
        self._running: dict[str, _Goal] = {}
        self._ended: dict[str, Message] = {}
        self.charged = 0

    def __contains__(self, id: str) -> bool:
        """Return True if the goal has not ended."""
        return id in self._running

    def receive(self, message: Message) -> None:
        """Handle a message of a peer."""
        try:
            if message.phase in STARTS:
                self._add(message)
            elif message.phase == Phase.CANCEL:
                self._cancel_for(message)
            elif message.phase == Phase.RESULT:
                self._attach(message)
            else:
                raise InvalidRequest("the message has no phase with which a goal is asked for")
        except RceError as error:
            self._interface.fail(message, error, Phase.CANCEL if message.phase == Phase.CANCEL else Phase.NONE)

    def _add(self, message: Message) -> None:
        id = check_goal_id(message.msg_id)
        if id in self._running or id in self._ended:
            raise AlreadyExists(f"goal {id} exists already: use a new id", field="msgID")
        if len(self._running) >= MAX_GOALS:
            raise LimitExceeded(f"interface {self._interface.spec.tag} has {MAX_GOALS} unfinished goals: send fewer")
        self._running[id] = _Goal(message.source, message.phase == Phase.LEASED_GOAL)
        try:
            self._start(message)
        except RceError:
            del self._running[id]
            raise

    def _cancel_for(self, message: Message) -> None:
        goal = self._running.get(message.msg_id)
        if goal is None:
            raise NotFound(f"goal {message.msg_id[:64]} has ended, or does not exist", field="msgID")
        self._cancel_when_accepted(message.msg_id, goal)

    def _cancel_when_accepted(self, id: str, goal: _Goal) -> None:
        goal.cancel = not goal.accepted
        if goal.accepted:
            self._cancel(id)

    def _attach(self, message: Message) -> None:
        goal, ended = self._running.get(message.msg_id), self._ended.get(message.msg_id)
        if goal is not None:
            goal.source = message.source
            if goal.accepted:  # the asker may have missed it
                self._send(Message(self._interface.id, message.msg_id, b"", message.source, phase=Phase.ACCEPTED))
        elif ended is not None:
            self._interface.request(replace(ended, destination=message.source))
        else:
            raise NotFound(f"goal {message.msg_id[:64]} does not exist, or its result is not kept any more")

    def left(self, peer: bytes) -> None:
        """Cancel the leased goals of a peer that is gone; the others go on, and their results are kept."""
        for id, goal in list(self._running.items()):
            if goal.source == peer and goal.leased:
                self._cancel_when_accepted(id, goal)

    def answer(self, id: str, phase: Phase, payload: Buffer = b"") -> None:
        """Send what became of a goal to its asker; the phases from SUCCEEDED on and REJECTED end it."""
        goal = self._running.get(id)
        if goal is None:
            return
        message = Message(self._interface.id, id, payload, goal.source, phase=phase)
        if phase == Phase.FEEDBACK and self._busy(goal.source):
            self._interface.dropped += 1
            return
        if phase >= Phase.SUCCEEDED:
            self._keep(id, message)
        if phase >= Phase.SUCCEEDED or phase == Phase.REJECTED:
            del self._running[id]
        self._send(message)
        if phase == Phase.ACCEPTED:
            goal.accepted = True
            if goal.cancel:
                goal.cancel = False
                self._cancel(id)

    def not_canceled(self, id: str, error: RceError) -> None:
        """Tell the asker why its goal is not canceled."""
        if (goal := self._running.get(id)) is not None:
            self._interface.fail(Message(goal.source, id, b""), error, Phase.CANCEL)

    def fail(self, id: str, error: RceError) -> None:
        """End a goal with an error."""
        if (goal := self._running.pop(id, None)) is not None:
            payload = msgspec.msgpack.encode(error.info)
            message = Message(self._interface.id, id, payload, goal.source, error=True)
            self._keep(id, message)
            self._send(message)

    def _busy(self, source: bytes) -> bool:
        link = self._interface.peers.get(source)
        waiting = 0 if link is None else link.backlog(self._interface.id)
        return waiting >= MAX_FEEDBACK or (waiting > 0 and self._interface.budget.full)

    def _send(self, message: Message) -> None:
        try:
            self._interface.request(message)
        except NotConnected:
            return  # the asker is gone; if it comes back, it asks for the result
        except LimitExceeded as error:
            log.warn("goal {id}: {phase} was not sent: {error}", id=message.msg_id, phase=message.phase, error=error)

    # what is kept: a holder of the interface's budget

    def _keep(self, id: str, message: Message) -> None:
        self._ended[id] = message
        self._charge(len(message.payload) + OVERHEAD)
        while len(self._ended) > MAX_KEPT or self.charged > MAX_KEPT_BYTES or self._interface.budget.full:
            if not self.drop_oldest(1):
                return

    def drop_oldest(self, spare: int) -> bool:
        """Forget the oldest result; return False if no more than `spare` are kept."""
        if len(self._ended) <= spare:
            return False
        message = self._ended.pop(next(iter(self._ended)))
        self._charge(-len(message.payload) - OVERHEAD)
        return True

    def _charge(self, amount: int) -> None:
        self.charged += amount
        self._interface.budget.charge(self, amount)

    def close(self) -> None:
        """Forget all goals and results."""
        self._running.clear()
        while self.drop_oldest(0):
            pass

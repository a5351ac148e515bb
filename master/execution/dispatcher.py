"""Dispatcher of control calls: calls about one thing reach a process in their order, others run concurrently."""

from __future__ import annotations

import asyncio
from typing import TypeVar

from master.graph.effects import Send
from master.graph.records import Ref
from rce.control.calls.call import Call
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.control.connection import Control
from rce.errors import TimedOut, Unavailable

R = TypeVar("R")


class Turn:
    """Place of one call in the queue of the calls about the same thing at one process.

    `control` is the connection at the time of the reservation; `sent` resolves when the call is about to be made, and
    `over` when the turn has ended.
    """

    __slots__ = ("before", "control", "over", "send", "sent")

    def __init__(self, send: Send, control: Control | None, before: list[asyncio.Future[None]]) -> None:
        self.send = send
        self.control = control
        self.before = before
        self.sent: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.over: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def going(self) -> None:
        """Let calls go ahead that only need to be made after this one."""
        if not self.sent.done():
            self.sent.set_result(None)

    def end(self) -> None:
        """Let the next call go ahead."""
        self.going()
        if not self.over.done():
            self.over.set_result(None)


class Dispatcher:
    """Makes calls at processes over the connections in `controls`.

    A call goes over the connection that was there when its turn was reserved. A process that joins later, or again,
    gets what it missed by its Sync, which is newer.
    """

    def __init__(self) -> None:
        self.controls: dict[str, Control] = {}
        self._last: dict[tuple[str, Ref | None], Turn] = {}

    def reserve(self, send: Send) -> Turn:
        """Take the turn of a call, in the order of reservations. The caller ends it."""
        key = (send.to, send.about)
        last = [self._last[each] for each in {key, (send.to, None)} if each in self._last]
        before = [turn.sent if _interrupts(send, turn.send) else turn.over for turn in last]
        turn = Turn(send, self.controls.get(send.to), before)
        self._last[key] = turn

        def forget(_: object) -> None:
            if self._last.get(key) is turn:
                del self._last[key]

        turn.over.add_done_callback(forget)
        return turn

    async def wait(self, turn: Turn) -> Control:
        """Wait until the calls before this turn have ended, and return the connection for its call.

        Raises:
            Unavailable: The process is not connected, or was connected anew since the reservation.
        """
        if turn.before:
            await asyncio.wait(turn.before)
        name = turn.send.to
        if turn.control is None or turn.control is not self.controls.get(name):
            raise Unavailable(f"{name} is not connected, or was connected anew")
        return turn.control

    async def settled(self, process: str, about: Ref) -> None:
        """Wait until all calls about something at a process have ended whose turns were reserved so far."""
        last = self._last.get((process, about))
        if last is not None:
            await asyncio.wait([last.over])

    async def ask(self, process: str, call: Call[R], seconds: float) -> R:
        """Make a call outside of all plans.

        Raises:
            Unavailable: The process is not connected.
            TimedOut: It did not answer within `seconds`.
            RceError: It refused the call.
        """
        control = self.controls.get(process)
        if control is None:
            raise Unavailable(f"{process} is not connected")
        try:
            return await asyncio.wait_for(control.call(call), seconds)
        except TimeoutError:
            raise TimedOut(f"{process} did not answer within {seconds:g} s") from None


def _interrupts(later: Send, earlier: Send) -> bool:
    """Return True for the removal of an environment that starts: its machine then cancels the start, which may hang."""
    return isinstance(later.call, StopEnvironment) and isinstance(earlier.call, StartEnvironment)

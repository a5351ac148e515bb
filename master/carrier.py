"""Carries plans out: makes their calls at the processes, in order for each thing, and knows what has become real."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TypeVar

from twisted.logger import Logger

from master.effects import Plan, Send, Settle
from rce.calls.call import Call
from rce.control import Control
from rce.errors import RceError, TimedOut, Unavailable
from rce.metrics import Family, gauge

log = Logger()
R = TypeVar("R")
Prepare = Callable[[Send], Awaitable[Send]]


class Carrier:
    """Calls go over the connections that are there when their plan is made; a process that joins later, or anew, has
    what it missed from its Sync, which is newer.
    """

    def __init__(self, prepare: Prepare, answered: Callable[[Send, object], None]) -> None:
        """`prepare` completes a call before it leaves; `answered` hears its result or the RceError that it raised."""
        self.controls: dict[str, Control] = {}
        self.watchers: list[Callable[[str], None]] = []  # called with what became real, or is not any more
        self._prepare = prepare
        self._answered = answered
        self._tails: dict[tuple[str, str], asyncio.Future[None]] = {}
        self._real: set[str] = set()
        self._waiting: dict[str, set[asyncio.Future[None]]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    # --- what is real -------------------------------------------------------------------------------------------------

    def settle(self, key: str, error: RceError | None = None) -> bool:
        """What `key` names is real, or will not be. Returns whether anybody was waiting to hear it."""
        self._note(key, error is None)
        waiting = [future for future in self._waiting.pop(key, ()) if not future.done()]
        for future in waiting:
            if error is None:
                future.set_result(None)
            else:
                future.set_exception(error)
        return bool(waiting)

    def forget(self, key: str) -> None:
        """What `key` names is not there any more, for now or for good; those who wait for it go on waiting."""
        self._note(key, False)

    def _note(self, key: str, real: bool) -> None:
        if real != (key in self._real):
            (self._real.add if real else self._real.discard)(key)
            for watcher in self.watchers:
                watcher(key)

    def is_real(self, key: str) -> bool:
        return key in self._real

    def expect(self, key: str) -> asyncio.Future[None]:
        """What is done once `key` is real, or fails once it never will be, from now on."""
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        if key in self._real:
            future.set_result(None)
        else:
            self._waiting.setdefault(key, set()).add(future)
        return future

    async def wait(self, key: str, seconds: float, expected: asyncio.Future[None] | None = None) -> None:
        """Until `key` is real; raises why it never will be, or TimedOut. `expected` is an `expect` of before."""
        future = expected or self.expect(key)
        try:
            await asyncio.wait_for(future, seconds)
        except TimeoutError:
            kind, _, name = key.partition(" ")
            raise TimedOut(f"{kind.lower()} {name} did not come up within {seconds:g} s") from None
        finally:
            self._give_up(key, future)

    def _give_up(self, key: str, future: asyncio.Future[None]) -> None:
        waiting = self._waiting.get(key)
        if waiting is not None:
            waiting.discard(future)
            if not waiting:
                del self._waiting[key]

    # --- plans --------------------------------------------------------------------------------------------------------

    def carry(self, plan: Plan) -> asyncio.Task[None]:
        """Begin to carry a plan out; the task ends with the first error that is not a process being away."""
        # The order of calls about one thing is taken here, at once, before anything waits.
        sequences = [[(step, self._turn(step) if isinstance(step, Send) else None) for step in steps] for steps in plan]
        task = asyncio.create_task(self._carry(sequences))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None and not isinstance(error, RceError):
            log.error("defect in carrying a plan out: {error!r}", error=error)

    def _turn(self, send: Send) -> _Turn:
        key = (send.to, send.key)
        before = [self._tails[each] for each in {key, (send.to, "")} if each in self._tails]
        turn = _Turn(self.controls.get(send.to), before, asyncio.get_running_loop().create_future())
        self._tails[key] = turn.mine

        def over(_: object) -> None:
            if self._tails.get(key) is turn.mine:
                del self._tails[key]

        turn.mine.add_done_callback(over)
        return turn

    async def _carry(self, sequences: list[list[tuple[Send | Settle, _Turn | None]]]) -> None:
        results = await asyncio.gather(*(self._run(steps) for steps in sequences), return_exceptions=True)
        for result in results:
            if isinstance(result, BaseException):
                raise result

    async def _run(self, steps: list[tuple[Send | Settle, _Turn | None]]) -> None:
        complete = True
        try:
            for step, turn in steps:
                if isinstance(step, Settle):
                    if complete:
                        self.settle(step.key)
                elif turn is not None:
                    complete = await self._reached(step, turn) and complete
        finally:
            for _, turn in steps:
                if turn is not None:
                    turn.end()

    async def _reached(self, send: Send, turn: _Turn) -> bool:
        """Whether the process was there to take the call: the others in the sequence get theirs in any case."""
        try:
            await self._send(send, turn)
        except Unavailable as error:
            log.info("{error}: it gets this when it joins again", error=str(error))
            return False
        except RceError as error:
            self._answered(send, error)
            raise
        return True

    async def _send(self, send: Send, turn: _Turn) -> None:
        if turn.before:
            await asyncio.wait(turn.before)
        try:
            if turn.control is None or turn.control is not self.controls.get(send.to):
                raise Unavailable(f"{send.to} is not connected, or not any more")
            ready = await self._prepare(send)
            self._answered(send, await turn.control.call(ready.call))
        finally:
            turn.end()

    async def ask(self, process: str, call: Call[R], seconds: float) -> R:
        """Outside of all plans. Unavailable if the process is not there, TimedOut if it takes longer."""
        control = self.controls.get(process)
        if control is None:
            raise Unavailable(f"{process} is not connected")
        try:
            return await asyncio.wait_for(control.call(call), seconds)
        except TimeoutError:
            raise TimedOut(f"{process} did not answer within {seconds:g} s") from None

    def families(self) -> list[Family]:
        waiting = sum(map(len, self._waiting.values()))
        return [
            gauge("rce_plans", "Commands whose effects are under way at processes", [], {(): len(self._tasks)}),
            gauge("rce_waiting", "Commands that wait for something to become real", [], {(): waiting}),
        ]

    async def close(self) -> None:
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class _Turn:
    """A place in the queue of the calls about one thing at one process."""

    __slots__ = ("before", "control", "mine")

    def __init__(self, control: Control | None, before: list[asyncio.Future[None]], mine: asyncio.Future[None]) -> None:
        self.control = control
        self.before = before
        self.mine = mine

    def end(self) -> None:
        if not self.mine.done():
            self.mine.set_result(None)

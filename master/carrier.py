"""Carries plans out: makes their calls at the processes, in order for each thing, and knows what has become real."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from twisted.logger import Logger

from master.effects import Plan, Send, Settle
from rce.control import Control
from rce.errors import RceError, TimedOut, Unavailable

log = Logger()
Prepare = Callable[[Send], Awaitable[Send]]


class Carrier:
    """Calls go to whoever is connected. A process that is away gets what it missed by its Sync when it joins."""

    def __init__(self, prepare: Prepare, synced: Callable[[Send, object], None]) -> None:
        self.controls: dict[str, Control] = {}
        self._prepare = prepare
        self._synced = synced
        self._tails: dict[tuple[str, str], asyncio.Future[None]] = {}
        self._real: set[str] = set()
        self._waiting: dict[str, asyncio.Future[None]] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    # --- what is real -------------------------------------------------------------------------------------------------

    def settle(self, key: str, error: RceError | None = None) -> bool:
        """What `key` names is real, or will not be. Returns whether anybody was waiting to hear it."""
        if error is None:
            self._real.add(key)
        else:
            self._real.discard(key)
        future = self._waiting.pop(key, None)
        if future is None or future.done():
            return False
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(error)
        return True

    def forget(self, key: str) -> None:
        """What `key` names is not there any more, for now or for good; those who wait for it go on waiting."""
        self._real.discard(key)

    def awaited(self, key: str) -> bool:
        return key in self._waiting

    def is_real(self, key: str) -> bool:
        return key in self._real

    async def wait(self, key: str, seconds: float) -> None:
        """Until `key` is real; raises why it never will be, or TimedOut."""
        if key in self._real:
            return
        future = self._waiting.get(key)
        if future is None:
            future = self._waiting[key] = asyncio.get_running_loop().create_future()
        try:
            await asyncio.wait_for(asyncio.shield(future), seconds)
        except TimeoutError:
            self._waiting.pop(key, None)
            raise TimedOut(f"{key.lower()} did not come up within {seconds:g} s") from None

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
        turn = _Turn(self._tails.get(key), asyncio.get_running_loop().create_future())
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
        try:
            for step, turn in steps:
                if isinstance(step, Settle):
                    self.settle(step.key)
                elif turn is not None:
                    await self._send(step, turn)
        except Unavailable as error:
            log.info("{error}: it gets this when it joins again", error=str(error))
        finally:
            for _, turn in steps:
                if turn is not None:
                    turn.end()

    async def _send(self, send: Send, turn: _Turn) -> None:
        if turn.before is not None:
            await asyncio.wait([turn.before])
        try:
            control = self.controls.get(send.to)
            if control is None:
                raise Unavailable(f"{send.to} is not connected")
            ready = await self._prepare(send)
            self._synced(send, await control.call(ready.call))
        finally:
            turn.end()

    async def close(self) -> None:
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


class _Turn:
    """A place in the queue of the calls about one thing at one process."""

    __slots__ = ("before", "mine")

    def __init__(self, before: asyncio.Future[None] | None, mine: asyncio.Future[None]) -> None:
        self.before = before
        self.mine = mine

    def end(self) -> None:
        if not self.mine.done():
            self.mine.set_result(None)

"""Where the Master's decisions leave it: what changed is stored, effects are carried out, users are told."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from twisted.logger import Logger

from master import presence
from master.carrier import Carrier
from master.effects import Plan, Send
from master.records import State
from master.store import Store
from rce.calls.robots import Tell
from rce.errors import ErrorInfo, NotFound, RceError
from rce.messages import StatusData

log = Logger()
T = TypeVar("T")


def ids() -> str:
    """A name that nothing else has, 32 hex."""
    return secrets.token_hex(16)


class Rim:
    """`sweep` is called when packages may have become needless."""

    def __init__(self, state: State, store: Store, carrier: Carrier, sweep: Callable[[], None]) -> None:
        self.state = state
        self.carrier = carrier
        self.listeners: list[Callable[[str, StatusData], None]] = []  # called with a user and what is told to them
        self._store = store
        self._sweep = sweep
        self._tasks: set[asyncio.Task[Any]] = set()

    def apply(self, plan: Plan) -> None:
        """Save what changed and carry the effects out; what fails is told to the user it concerns."""
        self.save()
        self.carrier.carry(plan).add_done_callback(_log_error)

    async def resettle(self) -> None:
        """There may be room for environments that wait for a machine."""
        self.apply(presence.resettle(self.state, ids))

    def save(self, by_command: bool = False) -> asyncio.Task[None]:
        """Begin to write what changed; who waits for something that is gone hears so.

        What a command took back was carried out until then: who made it is answered well.
        """
        state = self.state
        if state.packages.changed or any(key not in state.environments for key in state.environments.changed):
            self._sweep()
        for table in self.state.tables():
            for key in table.changed:
                if key not in table:
                    name = f"{table.kind.__name__} {key}"
                    gone = f"{table.kind.__name__.lower()} {key} was removed before it came up"
                    self.carrier.settle(name, None if by_command else NotFound(gone))
                    self.carrier.forget(name)
        return self.keep(asyncio.create_task(self._store.save(self.state)))

    def tell(self, user: str, status: StatusData | None = None, error: ErrorInfo | None = None) -> None:
        """A status or an error to all robots of a user; those without the feature `events` are spared."""
        if status is not None:
            for listener in self.listeners:
                listener(user, status)
        for robot in self.state.robots.by(user):
            if robot.endpoint in self.state.joined:
                self.carrier.carry([[Send(robot.endpoint, Tell(robot.name, status, error), robot.name)]])

    def later(self, seconds: float, work: Callable[[], Coroutine[None, None, None]]) -> asyncio.Task[None]:
        async def wait() -> None:
            await asyncio.sleep(seconds)
            await work()

        return self.keep(asyncio.create_task(wait()))

    def keep(self, task: asyncio.Task[T]) -> asyncio.Task[T]:
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(_log_error)
        return task

    async def close(self) -> None:
        """End all that goes on, and store what changed."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.carrier.close()
        await self.save()


def _log_error(task: asyncio.Task[Any]) -> None:
    if task.cancelled() or (error := task.exception()) is None:
        return
    if isinstance(error, RceError):
        log.warn("{error}", error=str(error))
    else:
        log.error("defect: {error!r}", error=error)

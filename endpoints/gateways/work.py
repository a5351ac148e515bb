"""Operations of one client that take longer: bounded in number and in what they hold."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from twisted.logger import Logger
from twisted.python.failure import Failure

from rce.errors import LimitExceeded
from rce.net.budget import MB

MAX_TASKS = 2000  # operations of one client in progress
MAX_HELD = 16 * MB  # bytes of the client that these may hold

log = Logger()


class Work:
    """Coroutines of one client; while they hold too much of its data, it is not read.

    Args:
        pause_reading: Stops reading from the client until a future is done.
    """

    def __init__(self, pause_reading: Callable[[asyncio.Future[None]], None]) -> None:
        self._pause_reading = pause_reading
        self._tasks: dict[asyncio.Task[None], int] = {}  # with the bytes that they hold
        self._room: asyncio.Future[None] | None = None  # set while no more is read because of them

    def run(self, work: Coroutine[Any, Any, None], size: int = 0) -> None:
        """Run a coroutine that holds `size` bytes of the client's data.

        Raises:
            LimitExceeded: Too many coroutines run.
        """
        try:
            self.check_room()
        except LimitExceeded:
            work.close()
            raise
        task = asyncio.create_task(work)
        self._tasks[task] = size
        task.add_done_callback(self._ran)
        if self._room is None and sum(self._tasks.values()) > MAX_HELD:
            self._room = asyncio.get_running_loop().create_future()
            self._pause_reading(self._room)

    def check_room(self) -> None:
        """Raise LimitExceeded if too many coroutines run."""
        if len(self._tasks) >= MAX_TASKS:
            raise LimitExceeded(f"{MAX_TASKS} operations are in progress: wait until some complete")

    def cancel(self) -> None:
        """Cancel all coroutines."""
        for task in self._tasks:
            task.cancel()

    def _ran(self, task: asyncio.Task[None]) -> None:
        del self._tasks[task]
        if self._room is not None and sum(self._tasks.values()) <= MAX_HELD:
            self._room.set_result(None)
            self._room = None
        if not task.cancelled() and (error := task.exception()) is not None:
            log.failure("defect in a gateway", failure=Failure(error))

"""Work that is repeated whatever happens to the database."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from twisted.logger import Logger

from master.storage.store import FAILURES

log = Logger()


async def repeat(seconds: float, work: Callable[[], Awaitable[object]], failed: str) -> None:
    """Do some work periodically, until cancelled.

    Args:
        seconds: Pause before each time.
        work: The work.
        failed: What could not be done, for the log, if the database does not work.
    """
    while True:
        await asyncio.sleep(seconds)
        try:
            await work()
        except FAILURES as error:
            log.warn("{failed}: {error}", failed=failed, error=str(error))

"""Lease: which of several Masters with one PostgreSQL database leads.

The leader holds a row of the database until a time of the database's clock, and renews it. A Master that finds the row
free, or not renewed for as long by its own clock, takes it with a new term. Clocks of different machines are never
compared: the leader counts by its own monotonic clock from before each renewal, and gives up well before others may
take the row. Even so a Master may be stopped for longer than it notices. So each transaction checks the term
(`leader_row.fence`), and the processes refuse calls of earlier terms (`rce.control.term`).

The design follows Gray and Cheriton, "Leases: an efficient fault-tolerant mechanism for distributed file cache
consistency" (1989), with a fencing token.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

from twisted.logger import Logger

from rce.errors import RceError, Unavailable

LEASE = 10.0  # seconds by the database's clock for which the row is held
RENEW_EVERY = 2.0  # seconds
STEP_DOWN = 6.0  # seconds since the begin of the last successful renewal: well before LEASE has passed
ASK_EVERY = 0.5  # seconds after which a standby asks again

log = Logger()


class Row(Protocol):
    """The row of the database that the leader holds."""

    async def take(self, url: str, seconds: float) -> tuple[int, str]:
        """Take the row for some seconds if it is free, for the Master with this URL.

        Returns:
            The new term and the URL, or 0 and the URL of the Master that holds it.

        Raises:
            Unavailable: The database does not answer.
        """

    async def renew(self, term: int, seconds: float) -> bool:
        """Hold the row for some seconds more; return False if another Master has it.

        Raises:
            Unavailable: The database does not answer.
        """

    async def release(self, term: int) -> None:
        """Free the row, if it is still held with this term.

        Raises:
            Unavailable: The database does not answer.
        """


class Lease:
    """The lease of this Master.

    Attributes:
        term: Number of this Master's leadership; it grows with each leader. 0 until this Master leads.
        leader: URL of the Master that leads, as far as is known.
        lost: Done, with the reason, when this Master does not lead any more.
    """

    def __init__(self, row: Row) -> None:
        """Prepare a lease, for which `take` waits."""
        self.term = 0
        self.leader = ""
        self.lost: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._row = row
        self._deadline = 0.0  # of the loop's clock
        self._renewing: asyncio.Task[None] | None = None
        self._step_down: asyncio.TimerHandle | None = None

    async def take(self, url: str) -> None:
        """Wait until this Master leads, whose entry has this URL, and hold the lease from then on."""
        loop = asyncio.get_running_loop()
        while True:
            began = loop.time()
            try:
                self.term, leader = await self._row.take(url, LEASE)
            except Unavailable as error:
                log.warn("waiting for the database: {error}", error=str(error))
                leader = ""
            if self.term:
                break
            if leader and leader != self.leader:
                log.info("this Master is a standby: {leader} leads", leader=leader)
            self.leader = leader
            await asyncio.sleep(ASK_EVERY)
        self.leader = leader
        log.info("this Master leads, with term {term}", term=self.term)
        self._extend(began)
        self._renewing = asyncio.create_task(self._renew())

    def _extend(self, began: float) -> None:
        """Count the lease from the begin of a request that took or renewed it."""
        loop = asyncio.get_running_loop()
        self._deadline = began + STEP_DOWN
        if self._step_down is not None:
            self._step_down.cancel()
        reason = f"the lease could not be renewed for {STEP_DOWN:g} s"
        self._step_down = loop.call_at(self._deadline, self.lose, reason)

    async def _renew(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(RENEW_EVERY)
            began = loop.time()
            try:
                held = await self._row.renew(self.term, LEASE)
            except Unavailable as error:
                log.warn("the lease is not renewed: {error}", error=str(error))
                continue
            if not held:
                self.lose("another Master leads")
                return
            self._extend(began)

    def lose(self, reason: str) -> None:
        """Lead no longer."""
        if not self.lost.done():
            self.lost.set_result(reason)

    @property
    def holds(self) -> bool:
        """True while no other Master can lead: what this one answers from its memory is true."""
        return bool(self.term) and not self.lost.done() and asyncio.get_running_loop().time() < self._deadline

    def check(self, term: int) -> None:
        """Refuse a call if this Master leads no longer, as far as it or the caller knows; see `rce.control.term.Fence`.

        Raises:
            Unavailable: It does not lead any more.
        """
        if term > self.term or not self.holds:
            raise not_leading(self.leader if term <= self.term else "")

    async def release(self) -> None:
        """Let another Master lead at once; nothing of this one may be stored any more."""
        for pending in (self._renewing, self._step_down):
            if pending is not None:
                pending.cancel()
        if self.term and not self.lost.done():
            self.lose("this Master ends")
            try:
                await self._row.release(self.term)
            except RceError as error:
                log.warn("the lease runs until its end: {error}", error=str(error))


def not_leading(leader: str) -> Unavailable:
    """Return the error of a Master that does not lead."""
    where = f": {leader} leads" if leader else ""
    return Unavailable(f"this Master is a standby{where}; name all Masters, and try again", leader=leader)

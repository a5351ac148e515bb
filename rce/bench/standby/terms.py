"""Terms of the Masters and the writes that they acknowledged: no Master may do so in the term of a later one."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from rce.api.client import ApiClient
from rce.api.views import accounts as views
from rce.errors import RceError

LOOK_EVERY = 0.02  # seconds
WRITE_EVERY = 0.3
LATE = 0.25  # seconds that a busy machine may see a new term late


class Leadership(NamedTuple):
    """A term: the URL of the Master, and when the term was first seen by the monotonic clock."""

    term: int
    url: str
    since: float


class Write(NamedTuple):
    """A write that a Master acknowledged: its URL, and when the request began and ended by the monotonic clock."""

    url: str
    began: float
    ended: float


class TermWatch:
    """Reads the row of the leader in the database all the time, over a socket that no fault concerns."""

    def __init__(self, connection: str) -> None:
        """Watch with a connection string of libpq."""
        self.terms: list[Leadership] = []
        self._connection = connection
        self._changed = asyncio.Condition()

    async def run(self) -> None:
        """Watch until cancelled."""
        import psycopg  # an extra

        while True:
            try:
                connection = await psycopg.AsyncConnection.connect(self._connection, autocommit=True)
                async with connection:
                    while True:
                        await self._look(connection)
                        await asyncio.sleep(LOOK_EVERY)
            except psycopg.Error:  # its connection may be among those that are ended
                await asyncio.sleep(LOOK_EVERY)

    async def _look(self, connection: object) -> None:
        cursor = await connection.execute("SELECT term, url FROM leader")  # type: ignore[attr-defined]
        term, url = await cursor.fetchone()
        if not self.terms or self.terms[-1].term != term:
            self.terms.append(Leadership(term, url, time.monotonic()))
            async with self._changed:
                self._changed.notify_all()

    @property
    def url(self) -> str:
        """URL of the Master that leads, or led last."""
        return self.terms[-1].url if self.terms else ""

    async def wait_for_another(self, url: str, seconds: float) -> float:
        """Wait until another Master leads; return when it was seen, by the monotonic clock.

        Raises:
            TimeoutError: None does within some seconds.
        """
        async with asyncio.timeout(seconds), self._changed:
            await self._changed.wait_for(lambda: self.url != url)
        return self.terms[-1].since


class Writer:
    """Writes through one Master, again and again: it creates and revokes an API key of an administrator.

    Attributes:
        acknowledged: The writes that were acknowledged.
        refused: Number of those that were not.
    """

    def __init__(self, api: ApiClient, url: str, name: str) -> None:
        """Write through the Master at `url`, whose client is `api`; keys are labelled with `name`."""
        self.acknowledged: list[Write] = []
        self.refused = 0
        self.kept: dict[str, str] = {}  # labels of acknowledged keys by id
        self._api = api
        self._url = url
        self._name = name

    async def run(self) -> None:
        """Write until cancelled."""
        number = 0
        while True:
            number += 1
            began = time.monotonic()
            try:
                await asyncio.to_thread(self._write, f"{self._name} {number}")
            except RceError:
                self.refused += 1
            else:
                self.acknowledged.append(Write(self._url, began, time.monotonic()))
            await asyncio.sleep(WRITE_EVERY)

    def _write(self, label: str) -> None:
        made = self._api.post(views.CreatedKey, "keys", body=views.NewKey(label=label))
        kept, self.kept = self.kept, {made.key.id: label}
        for key in kept:
            self._api.delete("keys", key)


def stale(writes: Iterable[Write], terms: Sequence[Leadership]) -> list[str]:
    """Return writes that a Master acknowledged in whole while another one led, as sentences.

    A write that began in a Master's own term, or ended in it, may have been stored in it.
    """
    found = []
    for write in writes:
        for leadership, following in zip(terms, [*terms[1:], None], strict=True):
            until = following.since if following is not None else float("inf")
            inside = write.began >= leadership.since + LATE and write.ended < until
            if inside and leadership.url != write.url:
                found.append(f"{write.url} acknowledged a write in term {leadership.term} of {leadership.url}")
    return found

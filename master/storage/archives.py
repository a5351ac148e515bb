"""Archives of users' packages in the database, where the next Master that leads finds them."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Collection
from functools import partial
from pathlib import Path

import sqlalchemy as sa

from master.storage.store import Store
from master.storage.tables import archives
from rce.errors import NotFound

PART = 1_000_000  # bytes of a row: a transaction of the store takes some milliseconds


class Archives:
    """Archives in PostgreSQL, in parts, so that neither memory nor the store's thread is taken by a large one."""

    def __init__(self, store: Store) -> None:
        self._store = store

    async def digests(self) -> set[str]:
        """Return the digests of all archives, also of those that are being stored."""
        query = sa.select(archives.c.digest).distinct()
        return set(await self._store.read(lambda connection: list(connection.scalars(query))))

    async def put(self, digest: str, path: Path) -> None:
        """Store an archive; it is complete when this returns."""
        with path.open("rb") as file:
            number = 0
            while data := await asyncio.to_thread(file.read, PART):
                row = {"digest": digest, "part": number, "data": data}
                await self._store.run(partial(_put, row), repeatable=True)
                number += 1

    async def fetch(self, digest: str, path: Path) -> None:
        """Write an archive to a file.

        Raises:
            NotFound: There is no such archive, or it is not complete.
        """
        found, number = hashlib.sha256(), 0
        with path.open("wb") as file:
            while (data := await self._store.read(partial(_part, digest, number))) is not None:
                found.update(data)
                await asyncio.to_thread(file.write, data)
                number += 1
        if found.hexdigest() != digest:
            path.unlink()  # noqa: ASYNC240  # local, and done at once
            raise NotFound(f"there is no archive {digest[:80]}")

    async def keep_only(self, named: Collection[str]) -> None:
        """Remove the archives whose digests are not in `named`."""
        query = archives.delete().where(archives.c.digest.not_in(named))
        await self._store.run(lambda connection: connection.execute(query), repeatable=True)


def _put(row: dict[str, object], connection: sa.Connection) -> None:
    same = (archives.c.digest == row["digest"]) & (archives.c.part == row["part"])
    connection.execute(archives.delete().where(same))
    connection.execute(archives.insert(), row)


def _part(digest: str, number: int, connection: sa.Connection) -> bytes | None:
    query = sa.select(archives.c.data).where((archives.c.digest == digest) & (archives.c.part == number))
    data = connection.execute(query).scalar()
    return None if data is None else bytes(data)

"""Writing to the database."""

from __future__ import annotations

from sqlite3 import Connection

import pytest

from rce.api.knowledge import StoredFile
from rce.errors import AlreadyExists, LimitExceeded
from rce.knowledge import writing
from rce.knowledge.repository import Repository


async def test_same_content_counts_once_for_an_entry(repository: Repository) -> None:
    def work(connection: Connection) -> None:
        row = writing.insert(connection, writing.Header("object", "a.b", "ann"))
        draft = writing.Draft("ann", "", "x" * 100, [StoredFile("a", 1000, "0" * 64)])
        for _ in range(3):
            row = writing.add_version(connection, row, draft)
        used = writing.usage(connection, "ann", 9)
        assert (used.entries, used.bytes, used.limit) == (1, 1100 + 3 * writing.VERSION_COST, 9)
        writing.check_quota(connection, "ann", used.bytes)
        with pytest.raises(LimitExceeded, match="the quota is 5"):
            writing.check_quota(connection, "ann", 5)

    await repository.database.run(work)


async def test_number_of_files_is_bounded(repository: Repository) -> None:
    def work(connection: Connection) -> None:
        row = writing.insert(connection, writing.Header("object", "a.b", "ann"))
        files = [StoredFile(str(number), 1, "0" * 64) for number in range(writing.MAX_FILES + 1)]
        with pytest.raises(LimitExceeded):
            writing.add_version(connection, row, writing.Draft("ann", "", "", files))

    await repository.database.run(work)


async def test_uid_that_exists_is_refused(repository: Repository) -> None:
    def work(connection: Connection) -> None:
        header = writing.Header("object", "a.b", "ann")
        writing.insert(connection, header)
        with pytest.raises(AlreadyExists, match=r"there is an object a\.b already"):
            writing.insert(connection, header)

    await repository.database.run(work)

"""Reading of entries within rights."""

from __future__ import annotations

from sqlite3 import Connection

import pytest

from rce.errors import NotFound
from rce.knowledge import records
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from tests.support.knowledge import new_entry


async def test_missing_and_hidden_entries_are_told_alike(repository: Repository) -> None:
    await repository.add("ann", new_entry(shared=["eve"]))

    def find(connection: Connection, user: str, uid: str) -> str:
        try:
            return str(records.find(connection, Reader(user), "object", uid)["uid"])
        except NotFound as error:
            return str(error).replace(uid, "")

    def work(connection: Connection) -> None:
        assert find(connection, "bob", "cup.blue") == find(connection, "bob", "cup.none") != ""
        assert find(connection, "ann", "cup.blue") == find(connection, "eve", "cup.blue") == "cup.blue"
        assert find(connection, "", "cup.blue") != "cup.blue"
        assert records.entries_of(connection, Reader("ann"), []) == []
        row = records.find(connection, Reader("ann"), "object", "cup.blue")
        with pytest.raises(NotFound, match="has no version 7"):
            records.find_version(connection, row, 7)

    await repository.database.run(work)

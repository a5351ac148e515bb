"""Subscriptions: which changes of entries a reader is told of."""

from __future__ import annotations

import json
from sqlite3 import Connection, Row
from typing import Annotated

from msgspec import Meta, Struct, field

from rce.api.knowledge import Change, Kind
from rce.control.calls.knowledge import NotedChange
from rce.knowledge.names import local_name
from rce.knowledge.records import Reader

AT_ONCE = 500
Number = Annotated[int, Meta(ge=0, lt=2**53)]
# The rights are those at the time of the change, since an entry that was removed has none.
KNOWN = """(:everything OR public OR author = :user
    OR EXISTS (SELECT 1 FROM json_each(readers) WHERE value = :user))"""


class Subscription(Struct, frozen=True):
    """Changes to tell of; all that fit every given value."""

    kind: Annotated[Kind | None, Meta(description="kind of the entries")] = None
    uid: Annotated[str, Meta(max_length=241, description="one entry")] = ""
    prefix: Annotated[str, Meta(max_length=241, description="beginning of the uid")] = ""
    cls: Annotated[
        str, Meta(max_length=400, description="class, or one above it, as IRI or as the last part of one")
    ] = field(name="class", default="")
    after: Annotated[
        Number | None, Meta(description="number of a change: begin with those after it; default: with the next")
    ] = None


def read_changes(
    connection: Connection, reader: Reader, wanted: Subscription, after: int | None
) -> tuple[list[Change], int]:
    """Return changes after a number, and the number up to which that are all; without one, only that number."""
    newest: int = connection.execute("SELECT COALESCE(MAX(number), 0) FROM changes").fetchone()[0]
    if after is None:
        return [], newest
    query = f"SELECT * FROM changes WHERE number > :after AND {KNOWN} ORDER BY number LIMIT {AT_ONCE}"
    rows = connection.execute(query, {"after": after, **reader.parameters}).fetchall()
    found = [_change(row) for row in rows if _fits(row, wanted)]
    return found, rows[-1]["number"] if len(rows) == AT_ONCE else newest


def read_noted(connection: Connection, after: int) -> tuple[list[NotedChange], int]:
    """Return all changes after a number, AT_ONCE at most, and the number of the last one."""
    query = f"SELECT * FROM changes WHERE number > ? ORDER BY number LIMIT {AT_ONCE}"
    rows = connection.execute(query, (after,)).fetchall()
    found = [
        NotedChange(row["action"], row["kind"], row["uid"], row["author"], row["user"], bool(row["public"]))
        for row in rows
    ]
    return found, rows[-1]["number"] if rows else after


def _fits(row: Row, wanted: Subscription) -> bool:
    uid = row["uid"]
    return (
        wanted.kind in (None, row["kind"])
        and wanted.uid.lower() in ("", uid)
        and uid.startswith(wanted.prefix.lower())
        and (not wanted.cls or _is_of_class(row, wanted.cls))
    )


def _is_of_class(row: Row, cls: str) -> bool:
    types = json.loads(row["types"])
    if ":" in cls:
        return cls in types
    return cls.lower() in (row["uid"].partition(".")[0], *map(local_name, types))


def _change(row: Row) -> Change:
    return Change(*(row[name] for name in Change.__struct_fields__))

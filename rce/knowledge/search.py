"""Search for entries: by kind, prefix, text, class and place, all of which must fit."""

from __future__ import annotations

from collections.abc import Mapping
from sqlite3 import Connection, Row
from typing import Annotated

from msgspec import Meta, Struct, field

from rce.api.knowledge import Entry, EntryPage, Kind, Latitude, Longitude
from rce.errors import InvalidRequest
from rce.knowledge.names import local_name
from rce.knowledge.records import READABLE, Reader, entries_of

MAX_PAGE = 1000
METRES_PER_DEGREE = 111_000.0
SUBCLASSES = f"""
    WITH RECURSIVE below (iri) AS (
        {{seeds}}
        UNION SELECT pair.low FROM below JOIN (SELECT DISTINCT high, low FROM subclasses) pair ON pair.high = below.iri
            WHERE EXISTS (SELECT 1 FROM subclasses s JOIN entries e ON e.id = s.entry
                WHERE s.high = pair.high AND s.low = pair.low AND {READABLE}))
    SELECT iri FROM below"""
"""The classes below others, by what the entries say that the reader may read."""


class Search(Struct, frozen=True):
    """Conditions that entries must meet to be found."""

    kind: Annotated[Kind | None, Meta(description="kind of the entries")] = None
    prefix: Annotated[str, Meta(max_length=241, description="beginning of the uid")] = ""
    text: Annotated[str, Meta(max_length=400, description="words of description, labels, comments and names")] = ""
    cls: Annotated[
        str, Meta(max_length=400, description="class, or one above it, as IRI or as the last part of one")
    ] = field(name="class", default="")
    author: Annotated[str, Meta(max_length=120, description="user who added it")] = ""
    latitude: Annotated[Latitude | None, Meta(description="of the place, with longitude and radius")] = None
    longitude: Annotated[Longitude | None, Meta(description="of the place")] = None
    radius: Annotated[float, Meta(ge=0, le=2e7, description="metres around the place")] = 1000.0
    limit: Annotated[int, Meta(ge=1, le=MAX_PAGE, description="entries of a page")] = 100
    after: Annotated[str, Meta(max_length=300, description="`next` of the page before")] = ""


def find_entries(connection: Connection, reader: Reader, wanted: Search) -> EntryPage:
    """Return a page of the entries that fit.

    Raises:
        InvalidRequest: Only one of latitude and longitude is given.
    """
    conditions, parameters = _conditions(wanted)
    parameters |= reader.parameters
    if wanted.cls:
        # A uid begins with the class that its author named, which need not be one of an ontology.
        conditions.append(f"(e.cls = :cls OR e.id IN (SELECT entry FROM types WHERE iri IN ({_below(wanted.cls)})))")
        parameters["cls"] = wanted.cls.lower().replace(" ", "")
        parameters["seed"] = wanted.cls if _is_iri(wanted.cls) else local_name(wanted.cls)
    if wanted.after:
        kind, _, uid = wanted.after.partition("/")
        conditions.append("(e.kind, e.uid) > (:after_kind, :after_uid)")
        parameters |= {"after_kind": kind, "after_uid": uid}
    where = " AND ".join([READABLE, *conditions])
    query = f"SELECT e.* FROM entries e WHERE {where} ORDER BY e.kind, e.uid LIMIT :limit"
    parameters["limit"] = wanted.limit + 1
    rows: list[Row] = connection.execute(query, parameters).fetchall()
    found = entries_of(connection, reader, rows[: wanted.limit])
    return EntryPage(found, _cursor(found[-1]) if len(rows) > wanted.limit else "")


def _below(cls: str) -> str:
    by_name = "SELECT iri FROM types WHERE local = :seed UNION SELECT high FROM subclasses WHERE high_local = :seed"
    return SUBCLASSES.format(seeds="VALUES (:seed)" if _is_iri(cls) else by_name)


def _is_iri(text: str) -> bool:
    return ":" in text


def _cursor(entry: Entry) -> str:
    return f"{entry.kind}/{entry.uid}"


def _conditions(wanted: Search) -> tuple[list[str], dict[str, object]]:
    conditions: list[str] = []
    parameters: dict[str, object] = {}
    equal: Mapping[str, object] = {"kind": wanted.kind, "author": wanted.author}
    for name, value in equal.items():
        if value:
            conditions.append(f"e.{name} = :{name}")
            parameters[name] = value
    if wanted.prefix:
        conditions.append("e.uid >= :prefix AND e.uid < :prefix || char(1114111)")
        parameters["prefix"] = wanted.prefix.lower().replace(" ", "")
    words = [word.replace('"', "") for word in wanted.text.replace("\0", " ").split()]
    if any(words):
        conditions.append("e.id IN (SELECT rowid FROM words WHERE words MATCH :match)")
        parameters["match"] = " ".join(f'"{word}"*' for word in words if word)
    if (wanted.latitude is None) != (wanted.longitude is None):
        raise InvalidRequest("give latitude and longitude, or neither", field="latitude")
    if wanted.latitude is not None:
        conditions.append("e.latitude BETWEEN :south AND :north")
        conditions.append("distance(e.latitude, e.longitude, :latitude, :longitude) <= :radius")
        height = wanted.radius / METRES_PER_DEGREE
        parameters |= {"south": wanted.latitude - height, "north": wanted.latitude + height, "radius": wanted.radius}
        parameters |= {"latitude": wanted.latitude, "longitude": wanted.longitude}
    return conditions, parameters

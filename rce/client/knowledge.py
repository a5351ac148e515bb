"""Blocking client of the knowledge service: recipes, objects and environments that robots share.

Only the standard library and msgspec are needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode

import msgspec

from rce.api.knowledge import (
    PREFIX,
    Change,
    Entry,
    EntryChange,
    EntryPage,
    Imported,
    Kind,
    Language,
    NewEntry,
    QueryRequest,
    QueryResult,
    Rating,
    Usage,
    Version,
)
from rce.client.service_client import ServiceClient

JSON = {"Content-Type": "application/json"}
BINARY = {"Content-Type": "application/octet-stream"}


class KnowledgeClient(ServiceClient):
    """Client of one platform's knowledge service. All methods block, and connect anew for each request.

    All methods raise `Unavailable` if the service cannot be reached, and otherwise the error with which it answers, for
    example `NotFound`.
    """

    prefix = PREFIX

    # --- entries -----------------------------------------------------------------------------------------------------

    def add(self, new: NewEntry) -> Entry:
        """Add an entry."""
        return self.value(self.ask("POST", "/entries", msgspec.json.encode(new), JSON), Entry)

    def get(self, kind: Kind, uid: str) -> Entry:
        """Return an entry."""
        return self.value(self.ask("GET", _path(kind, uid)), Entry)

    def owl(self, kind: Kind, uid: str, version: int | None = None) -> str:
        """Return the OWL text of a version, by default of the newest."""
        return self.ask("GET", f"{_path(kind, uid)}/owl{_version(version)}").body.decode()

    def change(self, kind: Kind, uid: str, change: EntryChange) -> Entry:
        """Change an entry of yours; another text or description is a new version."""
        return self.value(self.ask("PATCH", _path(kind, uid), msgspec.json.encode(change), JSON), Entry)

    def remove(self, kind: Kind, uid: str) -> None:
        """Remove an entry of yours with all of its versions."""
        self.ask("DELETE", _path(kind, uid))

    def rate(self, kind: Kind, uid: str, rating: float) -> Entry:
        """Rate an entry from 0 to 10."""
        body = msgspec.json.encode(Rating(rating))
        return self.value(self.ask("POST", f"{_path(kind, uid)}/rating", body, JSON), Entry)

    def versions(self, kind: Kind, uid: str) -> list[Version]:
        """Return all versions, the newest first."""
        return self.value(self.ask("GET", f"{_path(kind, uid)}/versions"), list[Version])

    def remove_version(self, kind: Kind, uid: str, number: int) -> None:
        """Remove an old version of an entry of yours."""
        self.ask("DELETE", f"{_path(kind, uid)}/versions/{number}")

    def search(
        self,
        *,
        kind: Kind | None = None,
        prefix: str = "",
        text: str = "",
        cls: str = "",
        author: str = "",
        place: tuple[float, float] | None = None,
        radius: float = 1000.0,
    ) -> Iterator[Entry]:
        """Yield the entries that fit all conditions.

        Args:
            kind: Kind of the entries.
            prefix: Beginning of the uid.
            text: Words of description, labels, comments and names.
            cls: Class, or one above it, as IRI or as the last part of one.
            author: User who added it.
            place: Latitude and longitude in degrees.
            radius: Metres around the place.
        """
        wanted: dict[str, Any] = {"kind": kind, "prefix": prefix, "text": text, "class": cls, "author": author}
        if place is not None:
            wanted |= {"latitude": place[0], "longitude": place[1], "radius": radius}
        after = ""
        while True:
            answer = self.ask("GET", f"/entries?{_query(wanted | {'after': after, 'limit': 1000})}")
            page = self.value(answer, EntryPage)
            yield from page.items
            after = page.next
            if not after:
                return

    # --- files -------------------------------------------------------------------------------------------------------

    def put_file(self, kind: Kind, uid: str, path: Path, name: str = "") -> Entry:
        """Add or replace a file of an entry of yours; by default under its own name."""
        with path.open("rb") as file:
            headers = BINARY | {"Content-Length": str(path.stat().st_size)}
            return self.value(self.ask("PUT", _file(kind, uid, name or path.name), file, headers), Entry)

    def fetch_file(self, kind: Kind, uid: str, name: str, path: Path, version: int | None = None) -> None:
        """Download a file of a version; it is written under a temporary name and then renamed."""
        self.download(_file(kind, uid, name) + _version(version), path)

    def remove_file(self, kind: Kind, uid: str, name: str) -> Entry:
        """Remove a file from the newest version; old versions keep it."""
        return self.value(self.ask("DELETE", _file(kind, uid, name)), Entry)

    # --- everything --------------------------------------------------------------------------------------------------

    def query(self, query: str, language: Language = "sparql") -> QueryResult:
        """Answer a query over all that you may read; each entry is a named graph."""
        body = msgspec.json.encode(QueryRequest(query, language))
        return self.value(self.ask("POST", "/query", body, JSON), QueryResult)

    def usage(self) -> Usage:
        """Return what your entries take of the quota."""
        return self.value(self.ask("GET", "/usage"), Usage)

    def changes(
        self, *, kind: Kind | None = None, uid: str = "", prefix: str = "", cls: str = "", after: int | None = None
    ) -> Iterator[Change]:
        """Yield changes as they happen, until the connection breaks.

        Args:
            kind: Kind of the entries.
            uid: One entry.
            prefix: Beginning of the uid.
            cls: Class, or one above it, as IRI or as the last part of one.
            after: Number of a change, to begin with those after it. Without it only new changes come.
        """
        wanted = {"kind": kind, "uid": uid, "prefix": prefix, "class": cls, "after": after}
        return self.events(f"/changes?{_query(wanted)}", Change)

    def export(self, path: Path) -> None:
        """Download all entries that you may read, with all versions and files, as one archive."""
        self.download("/archive", path)

    def restore(self, path: Path) -> Imported:
        """Add the entries of an archive; those whose uids exist stay as they are."""
        with path.open("rb") as file:
            headers = {"Content-Type": "application/zip", "Content-Length": str(path.stat().st_size)}
            return self.value(self.ask("POST", "/archive", file, headers), Imported)


def _path(kind: Kind, uid: str) -> str:
    return f"/entries/{kind}/{quote(uid, safe='')}"


def _file(kind: Kind, uid: str, name: str) -> str:
    return f"{_path(kind, uid)}/files/{quote(name, safe='')}"


def _version(number: int | None) -> str:
    return "" if number is None else f"?version={number}"


def _query(values: dict[str, Any]) -> str:
    return urlencode({name: value for name, value in values.items() if value not in (None, "")})

"""Paths of RoboEarth's own repository (api 0.1), for its clients: entries by kind, `serql` and `binary`.

Entries that come this way are public, as all were there. An API key of the platform is the original's `api_key`; a
reader gives it as `?key=`, unless the service lets anonymous clients read.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any

import msgspec
from aiohttp import BodyPartReader, web
from aiohttp.http_exceptions import HttpProcessingError
from msgspec import UNSET, Meta, Struct, UnsetType

from rce.api.knowledge import Description, Entry, EntryChange, Kind, Latitude, Location, Longitude, NewEntry, Owl
from rce.errors import InvalidRequest, NotFound
from rce.knowledge.names import check_kind
from rce.knowledge.queries import Queries
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.knowledge.rest import Rest, json_response
from rce.knowledge.search import Search
from rce.knowledge.serql import translate
from rce.services.auditing import ACTION
from rce.services.problems import decode
from rce.web.problems import HttpError
from rce.web.requests import read_accepted_body

PREFIXES = ("/api/0.1", "/knowledge-service/api/0.1")  # the Master redirects the second
TEXTS: dict[Kind, str] = {"recipe": "recipe", "object": "object_description", "environment": "environment"}
LISTS: dict[Kind, str] = {"recipe": "recipes", "object": "object_description", "environment": "environments"}
GONE = 410
MAX_FOUND = 100  # entries in an answer
PIECE = 64 * 1024
# What aiohttp raises for bodies that are no forms.
MALFORMED_FORM = (ValueError, AssertionError, LookupError, HttpProcessingError)


class Body(Struct, frozen=True):
    """Body of a request by a client of the original; only the text that belongs to the kind is read."""

    api_key: Annotated[str, Meta(max_length=200)] = ""
    cls: Annotated[str, Meta(max_length=120)] = msgspec.field(name="class", default="")
    id: Annotated[str, Meta(max_length=120)] = ""
    description: Description | UnsetType = UNSET
    recipe: Owl | UnsetType = UNSET
    object_description: Owl | UnsetType = UNSET
    environment: Owl | UnsetType = UNSET
    latitude: Latitude | None = None
    longitude: Longitude | None = None
    query: Annotated[str, Meta(max_length=20_000)] = ""


class Original:
    """Request handlers."""

    def __init__(self, rest: Rest, repository: Repository, queries: Queries) -> None:
        self._rest, self._repository, self._queries = rest, repository, queries

    def add(self, application: web.Application) -> None:
        """Add the routes."""
        for prefix in PREFIXES:
            router, entry = application.router, prefix + "/{kind:recipe|object|environment}"
            router.add_post(f"{prefix}/serql", self._serql)
            router.add_post(f"{prefix}/binary/objects/{{uid}}", self._file)
            router.add_post(entry, self._post)
            router.add_get(f"{entry}/{{uid}}", self._search)
            router.add_put(f"{entry}/{{uid}}", self._change)
            router.add_put(f"{entry}/{{uid}}/{{key}}/{{rating}}", self._rate)
            router.add_delete(f"{entry}/{{uid}}/{{key}}", self._remove)
            router.add_delete(f"{entry}/{{uid}}/{{key}}/{{file}}", self._remove_file)

    async def _post(self, request: web.Request) -> web.Response:
        """Add an entry, or answer a query."""
        kind, body = check_kind(request.match_info["kind"]), await _body(request)
        if body.query:
            return await self._answer(request, body)
        reader = await self._writer(request, body.api_key, "knowledge.add")
        location = None
        if body.latitude is not None and body.longitude is not None:
            location = Location(body.latitude, body.longitude)
        text = getattr(body, TEXTS[kind])
        if text is UNSET or not body.cls or not body.id:
            raise InvalidRequest(f"id, class and {TEXTS[kind]} must be given", field=TEXTS[kind])
        given = {"kind": kind, "class": body.cls, "id": body.id, "owl": text, "description": body.description or ""}
        new = decode(msgspec.json.encode(given), NewEntry)
        new = msgspec.structs.replace(new, public=True, location=location)
        return json_response(await self._record(request, reader, await self._repository.add(reader.user, new)))

    async def _search(self, request: web.Request) -> web.Response:
        """Answer with the first entries whose uids begin with the path's, each with all of its texts."""
        kind, reader = check_kind(request.match_info["kind"]), await self._rest.reader(request)
        wanted = Search(kind=kind, prefix=request.match_info["uid"][:241], limit=MAX_FOUND)
        found = (await self._repository.search(reader, wanted)).items
        if not found:
            raise HttpError(f"there is no {kind} whose uid begins so", status=GONE, field="uid")
        return json_response([await self._record(request, reader, entry) for entry in found])

    async def _change(self, request: web.Request) -> web.Response:
        """Change description and text of an entry."""
        kind, body = check_kind(request.match_info["kind"]), await _body(request)
        reader = await self._writer(request, body.api_key, "knowledge.change")
        change = EntryChange(owl=getattr(body, TEXTS[kind]), description=body.description)
        entry = await self._repository.change(reader, kind, request.match_info["uid"].lower(), change)
        return json_response(await self._record(request, reader, entry))

    async def _rate(self, request: web.Request) -> web.Response:
        """Rate an entry."""
        kind, rating = check_kind(request.match_info["kind"]), request.match_info["rating"]
        if not rating.isascii() or not rating.isdigit() or len(rating) > 2 or int(rating) > 10:
            raise InvalidRequest("the rating must be a number from 0 to 10", field="rating")
        reader = await self._writer(request, request.match_info["key"], "knowledge.rate")
        entry = await self._repository.rate(reader, kind, request.match_info["uid"].lower(), float(rating))
        return json_response(await self._record(request, reader, entry))

    async def _remove(self, request: web.Request) -> web.Response:
        """Remove an entry."""
        reader = await self._writer(request, request.match_info["key"], "knowledge.remove")
        kind = check_kind(request.match_info["kind"])
        await self._repository.remove(reader, kind, request.match_info["uid"].lower())
        return web.Response(status=204)

    async def _remove_file(self, request: web.Request) -> web.Response:
        """Remove a file of an entry."""
        reader = await self._writer(request, request.match_info["key"], "knowledge.remove_file")
        kind, uid = check_kind(request.match_info["kind"]), request.match_info["uid"].lower()
        await self._repository.remove_file(reader, kind, uid, request.match_info["file"])
        return web.Response(status=204)

    async def _serql(self, request: web.Request) -> web.Response:
        """Answer a query in SeRQL."""
        return await self._answer(request, await _body(request))

    async def _answer(self, request: web.Request, body: Body) -> web.Response:
        reader = await (self._rest.reader(request) if not body.api_key else self._with_key(request, body.api_key))
        return json_response(await self._queries.run(reader, translate(body.query)))

    async def _file(self, request: web.Request) -> web.Response:
        """Add a file: a form with `api_key`, optionally `type`, and then `file`."""
        key = ""
        async for part in _parts(request):
            if part.name == "api_key":
                key = (await _chunk(part, 200)).decode("ascii", "replace")
            if part.name == "file":
                reader = await self._writer(request, key, "knowledge.put_file")
                uid, name = request.match_info["uid"].lower(), part.filename or ""
                entry = await self._repository.put_file(reader, "object", uid, name, _pieces(part))
                return json_response(await self._record(request, reader, entry))
        raise InvalidRequest("the form has no file", field="file")

    async def _writer(self, request: web.Request, key: str, action: str) -> Reader:
        """Authenticate who changes something by the key in the body or in the path."""
        request[ACTION] = action
        return await self._rest.authenticated(request, "knowledge.write", {"Authorization": f"Bearer {key}"})

    async def _with_key(self, request: web.Request, key: str) -> Reader:
        return await self._rest.authenticated(request, "knowledge.read", {"Authorization": f"Bearer {key}"})

    async def _record(self, request: web.Request, reader: Reader, entry: Entry) -> dict[str, Any]:
        """Return an entry as the original did, with its newest three versions."""
        versions = (await self._repository.versions(reader, entry.kind, entry.uid))[:3]
        texts = []
        for version in versions:
            try:
                text = await self._repository.text(reader, entry.kind, entry.uid, version.number)
            except NotFound:  # removed meanwhile
                continue
            texts.append({"timestamp": int(version.time * 1000), "description": text.text})
        url = f"{request.url.origin()}/knowledge-service/entries/{entry.kind}/{entry.uid}/files"
        files = {
            file.name: {"url": f"{url}/{file.name}", "mime-type": "application/octet-stream"} for file in entry.files
        }
        record = {
            "id": entry.uid,
            "description": entry.description,
            "author": entry.author,
            "rating": entry.rating,
            LISTS[entry.kind]: texts,
            "files": files,
        }
        if entry.modified_by != entry.author:
            record["modified_by"] = entry.modified_by
        if entry.location is not None:
            record["location"] = entry.location
        return record


async def _body(request: web.Request) -> Body:
    return decode(await read_accepted_body(request), Body)


async def _parts(request: web.Request) -> AsyncIterator[BodyPartReader]:
    """Yield the fields of a form.

    Raises:
        InvalidRequest: The body is not a form.
    """
    try:
        parts = await request.multipart()
        while isinstance(part := await parts.next(), BodyPartReader):
            yield part
    except MALFORMED_FORM as error:
        raise _no_form(error) from None


async def _pieces(part: BodyPartReader) -> AsyncIterator[bytes]:
    while piece := await _chunk(part, PIECE):
        yield piece


async def _chunk(part: BodyPartReader, size: int) -> bytes:
    try:
        return bytes(await part.read_chunk(size))
    except MALFORMED_FORM as error:
        raise _no_form(error) from None


def _no_form(error: Exception) -> InvalidRequest:
    return InvalidRequest(f"the body is not a form (multipart/form-data): {error}", field="file")

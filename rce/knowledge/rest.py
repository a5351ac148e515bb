"""Handlers of the REST interface: entries, versions, files, changes and queries."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

import msgspec
from aiohttp import web
from msgspec import Meta
from twisted.logger import Logger

from rce.api.knowledge import PREFIX, EntryChange, Kind, NewEntry, QueryRequest, Rating
from rce.errors import InvalidRequest, RceError
from rce.knowledge.archive import Archive
from rce.knowledge.changes import Subscription
from rce.knowledge.names import check_kind
from rce.knowledge.queries import Queries
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository
from rce.knowledge.search import Search
from rce.knowledge.serql import translate
from rce.services.auditing import CLIENT
from rce.services.authentication import Authenticator
from rce.services.problems import convert, decode
from rce.web.requests import body_pieces, read_accepted_body
from rce.web.server import logged_in

HEARTBEAT = 15.0  # seconds without an event until a comment is sent
OWL_TYPES = {True: "application/rdf+xml; charset=utf-8", False: "text/turtle; charset=utf-8"}
VersionNumber = Annotated[int, Meta(ge=1, lt=2**31)]

T = TypeVar("T")
log = Logger()


class Rest:
    """Request handlers. Each authenticates the client first."""

    def __init__(
        self, authenticator: Authenticator, repository: Repository, queries: Queries, archive: Archive, anonymous: bool
    ) -> None:
        """Serve a repository; with `anonymous` also clients without credentials may read what is public."""
        self._authenticator = authenticator
        self._repository = repository
        self._queries = queries
        self._archive = archive
        self._anonymous = anonymous

    async def reader(self, request: web.Request) -> Reader:
        """Authenticate the client of a request that changes nothing.

        Raises:
            RceError: As `Authenticator.authenticate`.
        """
        given = "Authorization" in request.headers or "key" in request.query or "password" in request.query
        if self._anonymous and not given:
            logged_in()
            return Reader("")
        return await self.authenticated(request, "knowledge.read", request.headers)

    async def writer(self, request: web.Request) -> Reader:
        """Authenticate the client of a request that changes something; raises as `reader`."""
        return await self.authenticated(request, "knowledge.write", request.headers)

    async def authenticated(self, request: web.Request, operation: str, headers: Mapping[str, str]) -> Reader:
        """Authenticate the client of a request for an operation; its credentials are in `headers`, or in the query.

        Raises:
            RceError: As `Authenticator.authenticate`.
        """
        address = request.remote or ""
        client = await self._authenticator.authenticate(headers, request.query, operation, address)
        logged_in()
        request[CLIENT] = client
        return Reader(client.user, client.identity.reach == "all")

    # --- entries -----------------------------------------------------------------------------------------------------

    async def search(self, request: web.Request) -> web.Response:
        """Search for entries."""
        reader = await self.reader(request)
        return json_response(await self._repository.search(reader, _parameters(request, Search)))

    async def add(self, request: web.Request) -> web.Response:
        """Add an entry."""
        reader = await self.writer(request)
        entry = await self._repository.add(reader.user, decode(await read_accepted_body(request), NewEntry))
        location = f"{request.url.origin()}{PREFIX}/entries/{entry.kind}/{entry.uid}"
        return json_response(entry, 201, {"Location": location})

    async def show(self, request: web.Request) -> web.Response:
        """Answer with an entry."""
        return json_response(await self._repository.entry(await self.reader(request), *_name(request)))

    async def change(self, request: web.Request) -> web.Response:
        """Change an entry."""
        reader = await self.writer(request)
        change = decode(await read_accepted_body(request), EntryChange)
        return json_response(await self._repository.change(reader, *_name(request), change))

    async def remove(self, request: web.Request) -> web.Response:
        """Remove an entry."""
        await self._repository.remove(await self.writer(request), *_name(request))
        return web.Response(status=204)

    async def rate(self, request: web.Request) -> web.Response:
        """Rate an entry."""
        reader = await self.writer(request)
        rating = decode(await read_accepted_body(request), Rating).rating
        return json_response(await self._repository.rate(reader, *_name(request), rating))

    async def owl(self, request: web.Request) -> web.Response:
        """Send the OWL text of a version."""
        found = await self._repository.text(await self.reader(request), *_name(request), _version(request))
        headers = {"Content-Type": OWL_TYPES[found.text.lstrip().startswith("<")], "X-Version": str(found.version)}
        return web.Response(body=found.text.encode(), headers=headers)

    async def versions(self, request: web.Request) -> web.Response:
        """List the versions of an entry, the newest first."""
        return json_response(await self._repository.versions(await self.reader(request), *_name(request)))

    async def remove_version(self, request: web.Request) -> web.Response:
        """Remove an old version."""
        reader = await self.writer(request)
        number = convert(request.match_info["version"], VersionNumber)
        await self._repository.remove_version(reader, *_name(request), number)
        return web.Response(status=204)

    # --- files -------------------------------------------------------------------------------------------------------

    async def put_file(self, request: web.Request) -> web.Response:
        """Add or replace a file."""
        reader = await self.writer(request)
        name = request.match_info["file"]
        return json_response(await self._repository.put_file(reader, *_name(request), name, body_pieces(request)))

    async def file(self, request: web.Request) -> web.StreamResponse:
        """Send a file."""
        reader, name = await self.reader(request), request.match_info["file"]
        path = await self._repository.file(reader, *_name(request), name, _version(request))
        # Files are what users sent: no browser may take one for a page of this site.
        headers = {
            "Content-Type": "application/octet-stream",
            "X-Content-Type-Options": "nosniff",
            "Content-Disposition": f'attachment; filename="{name}"',
        }
        return web.FileResponse(path, headers=headers)

    async def remove_file(self, request: web.Request) -> web.Response:
        """Remove a file from the newest version."""
        reader = await self.writer(request)
        return json_response(await self._repository.remove_file(reader, *_name(request), request.match_info["file"]))

    # --- everything --------------------------------------------------------------------------------------------------

    async def query(self, request: web.Request) -> web.Response:
        """Answer a query."""
        reader = await self.reader(request)
        wanted = decode(await read_accepted_body(request), QueryRequest)
        sparql = translate(wanted.query) if wanted.language == "serql" else wanted.query
        return json_response(await self._queries.run(reader, sparql))

    async def usage(self, request: web.Request) -> web.Response:
        """Answer with the client's use of the quota."""
        return json_response(await self._repository.usage((await self.reader(request)).user))

    async def export(self, request: web.Request) -> web.StreamResponse:
        """Send all entries that the client may read, as an archive."""
        reader = await self.reader(request)
        async with self._archive.export(reader) as path:
            return await _send_file(request, path.open("rb"))

    async def restore(self, request: web.Request) -> web.Response:
        """Add the entries of an archive."""
        reader = await self.writer(request)
        return json_response(await self._archive.restore(reader, body_pieces(request)))

    # --- changes -----------------------------------------------------------------------------------------------------

    async def changes(self, request: web.Request) -> web.StreamResponse:
        """Stream changes as server-sent events `change`."""
        reader = await self.reader(request)
        invalidation = self._authenticator.invalidation(reader.user)
        wanted = _parameters(request, Subscription)
        last = request.headers.get("Last-Event-ID", "")
        after = int(last) if last.isascii() and last.isdigit() and len(last) < 18 else wanted.after
        headers = {"Content-Type": "text/event-stream", "Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        stream = web.StreamResponse(headers=headers)
        await stream.prepare(request)
        await stream.write(b": here\n\n")
        with contextlib.suppress(ConnectionError):
            try:
                while True:
                    event = self._repository.next_change()
                    if invalidation.done():
                        reader = await self.reader(request)
                        invalidation = self._authenticator.invalidation(reader.user)
                    found, after = await self._repository.changes(reader, wanted, after)
                    for each in found:
                        data = msgspec.json.encode(each)
                        await stream.write(b"event: change\nid: %d\ndata: %b\n\n" % (each.number, data))
                    await _wait(event, invalidation, stream)
            except RceError as error:  # such as Unauthorized
                log.info("event stream closed: {error}", error=str(error))
        return stream


async def _wait(event: asyncio.Event, invalidation: asyncio.Future[None], stream: web.StreamResponse) -> None:
    """Wait until there is a change or the client must authenticate again; keep the connection alive meanwhile."""
    waiting = asyncio.ensure_future(event.wait())
    ends: set[asyncio.Future[Any]] = {waiting, invalidation}
    try:
        while not any(end.done() for end in ends):
            done, _ = await asyncio.wait(ends, timeout=HEARTBEAT, return_when=asyncio.FIRST_COMPLETED)
            if not done:
                await stream.write(b": still here\n\n")
    finally:
        waiting.cancel()


async def _send_file(request: web.Request, file: Any) -> web.StreamResponse:
    """Send a file that is about to be removed."""
    headers = {"Content-Type": "application/zip", "Content-Disposition": 'attachment; filename="knowledge.zip"'}
    answer = web.StreamResponse(headers=headers)
    with file:
        await answer.prepare(request)
        while piece := await asyncio.to_thread(file.read, 1024 * 1024):
            await answer.write(piece)
        await answer.write_eof()
    return answer


def _name(request: web.Request) -> tuple[Kind, str]:
    """Return kind and uid of the entry that the path names."""
    return check_kind(request.match_info["kind"]), request.match_info["uid"].lower()


def _version(request: web.Request) -> int | None:
    given = request.query.get("version")
    if given is None:
        return None
    if not given.isascii() or not given.isdigit() or len(given) > 9:
        raise InvalidRequest("version must be a number", field="version")
    return int(given)


def _parameters(request: web.Request, kind: type[T]) -> T:
    """Return the parameters of a query; unknown ones are ignored, as those of the credentials."""
    query: Mapping[str, str] = request.query
    return convert({name: value for name, value in query.items() if value}, kind)


def json_response(value: object, status: int = 200, headers: dict[str, str] | None = None) -> web.Response:
    """Return a value as JSON."""
    body = msgspec.json.encode(value)
    return web.Response(status=status, body=body, content_type="application/json", headers=headers)

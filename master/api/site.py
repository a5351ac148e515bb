"""The HTTP server of one Master: the API and the dashboard under their prefixes, the robots' entry everywhere else.

Bodies are limited before any of them is read: uploads that were announced go straight to disk, all others must be
small, except those that the handler of their route passes on. A large body for a service is redirected to it. Clients
that send `Expect: 100-continue`, as curl does, have sent nothing of it by then.
"""

from __future__ import annotations

from aiohttp import web
from twisted.logger import Logger

from master import dashboard
from master.api.authentication import authorization
from master.api.router import PREFIX, Api
from master.entry import Entry
from master.graph.state import State
from master.redirect import ServiceRedirects
from master.storage.depot import UPLOAD_PATH, Depot, Upload
from rce.errors import Unavailable, describe_os_error
from rce.web.problems import problem_response
from rce.web.requests import accept_body, body_pieces, declared_length, raw_path, read_body
from rce.web.server import Endpoint, listen, logged_in, serve_handler

MAX_BODY = 65_536  # bytes, except of uploads
OUTSIDE_PREFIX = ("healthz", "readyz", "metrics")  # of the API, as monitoring expects them

log = Logger()


class Site:
    """Routes requests by their paths."""

    def __init__(self, state: State, api: Api, depot: Depot) -> None:
        self._api = api
        self._depot = depot
        self._entry = Entry(state)
        self._dashboard = dashboard.Dashboard(state)
        self._redirects = ServiceRedirects(state)
        self._runner: web.ServerRunner | None = None

    async def start(self, endpoint: Endpoint) -> tuple[str, int]:
        """Listen, and return the host and port.

        Raises:
            Unavailable: The port is in use or cannot be bound.
        """
        self._runner = serve_handler(self.handle)
        return await listen(self._runner, endpoint)

    async def stop(self) -> None:
        """Close the listening socket and all connections."""
        await self._api.stop()
        if self._runner is not None:
            await self._runner.cleanup()

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer a request."""
        upload = self._begin_upload(request)
        if upload is not None:
            logged_in()
            try:
                await _receive(request, upload)
                return await self._api.handle(request, b"", upload)
            except ConnectionError:
                raise  # the client disconnected
            except OSError as error:
                log.error("an upload cannot be stored: {error}", error=describe_os_error(error))
                return problem_response(Unavailable(f"the upload cannot be stored: {describe_os_error(error)}"))
            finally:
                upload.close()
        if self._api.streams(request):
            return await self._api.handle(request, b"", None)
        length = declared_length(request)
        if length is None or length > MAX_BODY:
            return self._refuse_body(request)
        return await self._route(request, await read_body(request) if length else b"")

    async def _route(self, request: web.BaseRequest, content: bytes) -> web.StreamResponse:
        path = raw_path(request)
        if path.startswith(PREFIX + "/") or path.removeprefix("/").partition("/")[0] in OUTSIDE_PREFIX:
            return await self._api.handle(request, content, None)
        if path.startswith(dashboard.PREFIX):
            return self._dashboard.handle(request)
        if path == dashboard.PREFIX.rstrip("/") or dashboard.wants_dashboard(request):
            return web.Response(status=302, headers={"Location": dashboard.PREFIX})
        try:
            location = self._redirects.location(request)
        except Unavailable as error:
            return web.Response(status=503, text=f"{error}\n")
        if location:
            return web.Response(status=307, headers={"Location": location})
        return self._entry.handle(request)

    def _begin_upload(self, request: web.BaseRequest) -> Upload | None:
        """Return where the body goes if the request is an upload that was announced, of the announced size."""
        if request.method != "PUT" or raw_path(request) != UPLOAD_PATH:
            return None
        scheme, token = authorization(request)
        return self._depot.begin(token, declared_length(request)) if scheme == "bearer" else None

    def _refuse_body(self, request: web.BaseRequest) -> web.Response:
        """Redirect a large body to the service that it is for, or refuse it, and close the connection."""
        try:
            location = self._redirects.location(request)
        except Unavailable:
            response = web.Response(status=503)
        else:
            if location:
                response = web.Response(status=307, headers={"Location": location})
            else:
                response = web.Response(status=413, reason="Content Too Large")
        response.force_close()
        return response


async def _receive(request: web.BaseRequest, upload: Upload) -> None:
    """Write the body to disk as it comes.

    Raises:
        web.HTTPException: It came too slowly, or is malformed or compressed.
    """
    await accept_body(request)
    async for piece in body_pieces(request):
        upload.write(piece)

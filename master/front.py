"""The open ports of a Master. Until it leads, it refuses everything and names the Master that does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from aiohttp import web

from master.api.router import PREFIX
from master.api.site import OUTSIDE_PREFIX, Site
from master.dashboard import PREFIX as DASHBOARD
from master.dashboard import wants_dashboard
from master.service import Master
from master.storage.lease import Lease, not_leading
from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import Control, Handlers
from rce.errors import RceError
from rce.web.problems import problem_response
from rce.web.requests import raw_path

PATIENCE = 5.0  # seconds for which a process that asks to join waits for a standby to lead, so that it asks seldom
RETRY_AFTER = 1  # seconds


class Front:
    """Passes requests and processes to the Master once it leads, and as long as it does; without a lease always."""

    def __init__(self, lease: Lease | None = None) -> None:
        self._lease = lease
        self._parts: asyncio.Future[tuple[Master, Site]] = asyncio.get_running_loop().create_future()

    def lead(self, master: Master, site: Site) -> None:
        """Begin to serve."""
        self._parts.set_result((master, site))

    def close(self) -> None:
        """Refuse the processes that wait."""
        if not self._parts.done():
            self._parts.set_exception(not_leading(self._leader))
            self._parts.exception()  # it is no defect if none waits

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        """Answer a request."""
        if self._parts.done() and (self._lease is None or self._lease.holds):
            return await self._parts.result()[1].handle(request)
        return standby_response(request, self._leader)

    @property
    def _leader(self) -> str:
        return self._lease.leader if self._lease is not None else ""

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        """Let a process join; see `rce.control.server.Joiner`.

        Raises:
            Unavailable: This Master does not lead.
            RceError: The process is refused.
        """
        await asyncio.wait([self._parts], timeout=PATIENCE)
        if not self._parts.done():
            raise not_leading(self._leader)
        return await self._parts.result()[0].join(hello, address)


def standby_response(request: web.BaseRequest, leader: str) -> web.Response:
    """Return the answer of a Master that does not lead.

    A browser is redirected to the leader. Programs are not, since their credentials are not for whoever a server names.
    """
    path = raw_path(request)
    if path == "/healthz":
        return web.json_response({"status": "standby", "missing": []})
    if leader and (path.startswith(DASHBOARD) or wants_dashboard(request)):
        return web.Response(status=307, headers={"Location": leader.rstrip("/") + request.raw_path})
    error = not_leading(leader).with_fields(retry_after=RETRY_AFTER)
    if path.startswith(PREFIX + "/") or path.removeprefix("/").partition("/")[0] in OUTSIDE_PREFIX:
        return problem_response(error)
    return _text(error)


def _text(error: RceError) -> web.Response:
    """Return an answer of one line of text, as the robots' entry gives."""
    headers = {"Retry-After": str(RETRY_AFTER), "Access-Control-Allow-Origin": "*"}
    return web.Response(status=503, text=f"{error}\n", headers=headers)

"""The map service put together, on a port."""

from __future__ import annotations

import asyncio
import logging
import ssl
from collections.abc import Callable
from pathlib import Path

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from msgspec import Struct
from twisted.logger import Logger

from rce.calls.call import Nothing
from rce.calls.services import ForgetProofs
from rce.control import Handlers
from rce.errors import no_port
from rce.map_jobs import PREFIX
from rce.mapservice import health, openapi
from rce.mapservice import jobs as jobs_module
from rce.mapservice import uploads as uploads_module
from rce.mapservice.access import Access, Master
from rce.mapservice.jobs import Jobs, Workers
from rce.mapservice.noting import noting
from rce.mapservice.problems import problems
from rce.mapservice.rest import Rest
from rce.mapservice.soap import Soap
from rce.mapservice.uploads import Uploads

READ_AHEAD = 1024 * 1024  # bytes of an upload that wait in memory
BODY_MOST = 9 * 1024 * 1024  # bytes of a body that is not streamed: SOAP with a recording
SWEEP = 600.0  # seconds
SHUTDOWN = 5.0

log = Logger()


def _is_readable(record: logging.LogRecord) -> bool:
    """Not of a request that is no HTTP: aiohttp would log its line, with the credentials in it."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError)


logging.getLogger("aiohttp.server").addFilter(_is_readable)


class Limits(Struct, frozen=True):
    """All limits of the service."""

    uploads: uploads_module.Limits
    jobs: jobs_module.Limits


class MapService:
    """Uploads, jobs and the server in front of them. `entry` and `trust`: of the platform."""

    def __init__(
        self,
        directory: Path,
        master: Callable[[], Master],
        workers: Workers,
        limits: Limits,
        entry: str,
        trust: str = "",
    ) -> None:
        access = self.access = Access(master)
        self.jobs = Jobs(directory / "jobs", lambda: self.uploads, workers, access, limits.jobs, entry, trust)
        self.uploads = Uploads(directory / "uploads", limits.uploads, self.jobs.size)
        application = web.Application(middlewares=[problems, noting(access)], client_max_size=BODY_MOST)
        rest = Rest(access, self.uploads, self.jobs)
        openapi.add(application, openapi.routes(rest), rest.asked)
        Soap(access, self.uploads, self.jobs).add(application)
        health.add(application, access)
        self._runner = web.AppRunner(
            application, handle_signals=False, access_log=None, shutdown_timeout=SHUTDOWN, read_bufsize=READ_AHEAD
        )
        self._sweeper: asyncio.Task[None] | None = None

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> int:
        """Returns the port."""
        await self._runner.setup()
        try:
            await web.TCPSite(self._runner, host, port, ssl_context=tls).start()
        except OSError as error:
            raise no_port(host, port, error) from None
        self._sweeper = asyncio.create_task(self._sweep())
        found: int = self._runner.addresses[0][1]
        log.info("maps are made at {host}:{port}{prefix}/", host=host, port=found, prefix=PREFIX)
        return found

    def handlers(self) -> Handlers:
        """The Master's calls."""
        handlers = Handlers()
        handlers.on(ForgetProofs, self._forget)
        handlers.tell_metrics("map-service", self.jobs.families)
        return handlers

    async def _forget(self, call: ForgetProofs) -> Nothing:
        self.access.forget(call.user)
        return Nothing()

    async def _sweep(self) -> None:
        while True:
            try:
                await self.jobs.sweep()
                await self.uploads.sweep(self.jobs.uses)
            except OSError as error:
                log.error("expired files could not be removed: {error}", error=str(error))
            await asyncio.sleep(SWEEP)

    async def stop(self) -> None:
        if self._sweeper is not None:
            self._sweeper.cancel()
        await self.jobs.stop()
        await self._runner.cleanup()

"""Assembly of the map service: uploads, jobs and the HTTP server."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable
from pathlib import Path

from aiohttp import web
from msgspec import Struct
from twisted.logger import Logger

from rce.api.map_jobs import PREFIX
from rce.control.calls.services import InvalidateAuthentication
from rce.control.connection import Handlers
from rce.control.removed_users import RemovedUsers
from rce.mapservice import openapi
from rce.mapservice.job_store import JobStore
from rce.mapservice.jobs import JobLimits, Jobs, Runner
from rce.mapservice.plans import Plans
from rce.mapservice.rest import Rest
from rce.mapservice.soap import Soap
from rce.mapservice.uploads import UploadLimits, Uploads
from rce.services import health
from rce.services.auditing import audit_middleware
from rce.services.authentication import Authenticator, Master
from rce.services.cors import allow_origins
from rce.services.problems import problems
from rce.web.server import Endpoint, listen, serve_application

READ_BUFFER = 1024 * 1024  # bytes of an upload that are buffered in memory
MAX_BODY = 9 * 1024 * 1024  # bytes of a body that is not streamed: SOAP with a recording
SWEEP_INTERVAL = 600.0  # seconds
SHUTDOWN_TIMEOUT = 5.0
ACTIONS = {
    "POST /uploads": "upload.create",
    "DELETE /uploads/{upload}": "upload.remove",
    "POST /jobs": "job.submit",
    "POST /jobs/{job}/cancel": "job.cancel",
    "DELETE /jobs/{job}": "job.remove",
}
"""Audited routes; not PATCH, of which an upload may need thousands. SOAP handlers set their actions themselves."""

log = Logger()


class MapServiceLimits(Struct, frozen=True):
    """Limits of the map service for uploads and jobs."""

    uploads: UploadLimits
    jobs: JobLimits


class MapService:
    """Uploads, jobs and the HTTP server in front of them."""

    def __init__(
        self,
        directory: Path,
        master: Callable[[], Master],
        runner: Runner,
        limits: MapServiceLimits,
        entry: str,
        trust: str = "",
    ) -> None:
        """Load uploads and jobs from `directory`; `entry` and `trust` are those of `Jobs`."""
        store = JobStore(directory / "jobs")
        self.authenticator = Authenticator(master)
        self.uploads = Uploads(directory / "uploads", limits.uploads, store.size)
        self.jobs = Jobs(store, self.uploads, runner, self.authenticator, limits.jobs, entry, trust)
        self._store = store
        self._removed = RemovedUsers(directory / "removed-users", self._forget)
        application = web.Application(
            middlewares=[audit_middleware(self.authenticator, PREFIX, ACTIONS), problems], client_max_size=MAX_BODY
        )
        allow_origins(application)
        rest = Rest(self.authenticator, self.uploads, self.jobs, Plans(self.jobs))
        openapi.add(application, openapi.routes(rest), rest.check_expectation)
        Soap(self.authenticator, self.uploads, self.jobs).add(application)
        health.add(application, self.authenticator)
        self._runner = serve_application(application, shutdown_timeout=SHUTDOWN_TIMEOUT, read_bufsize=READ_BUFFER)
        self._sweeper: asyncio.Task[None] | None = None

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> int:
        """Listen for clients; return the port.

        Raises:
            Unavailable: The port cannot be listened on.
        """
        _, actual_port = await listen(self._runner, Endpoint(host, port, tls))
        self._sweeper = asyncio.create_task(self._sweep())
        log.info("listening at {host}:{port}{prefix}/", host=host, port=actual_port, prefix=PREFIX)
        return actual_port

    def handlers(self) -> Handlers:
        """Return the handlers for the Master's calls."""
        handlers = Handlers()
        handlers.do(InvalidateAuthentication, lambda call: self.authenticator.invalidate(call.user))
        self._removed.add_to(handlers)
        handlers.serve_metrics("map-service", self.jobs.families)
        return handlers

    async def _forget(self, user: str) -> None:
        await self.jobs.forget(user)
        await self.uploads.forget(user)

    async def _sweep(self) -> None:
        while True:
            try:
                await self._store.sweep()
                await self.uploads.sweep(self.jobs.uses)
            except OSError as error:
                log.error("cannot remove expired files: {error}", error=str(error))
            await asyncio.sleep(SWEEP_INTERVAL)

    async def stop(self) -> None:
        """Stop jobs and the HTTP server."""
        if self._sweeper is not None:
            self._sweeper.cancel()
        await self.jobs.stop()
        await self._runner.cleanup()

"""Assembly of the knowledge service: repository, queries and the HTTP server."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable
from pathlib import Path

from aiohttp import web
from msgspec import Struct
from twisted.logger import Logger

from rce.api.knowledge import PREFIX
from rce.control.calls.knowledge import AnswerKnowledge
from rce.control.calls.services import InvalidateAuthentication
from rce.control.connection import Handlers
from rce.control.removed_users import RemovedUsers
from rce.knowledge import openapi
from rce.knowledge.archive import Archive
from rce.knowledge.environments import Environments
from rce.knowledge.original import Original
from rce.knowledge.queries import Queries, QueryLimits
from rce.knowledge.reports import report_changes
from rce.knowledge.repository import Repository, RepositoryLimits
from rce.knowledge.rest import Rest
from rce.knowledge.texts import Texts
from rce.services import health
from rce.services.auditing import audit_middleware
from rce.services.authentication import Authenticator, Master
from rce.services.cors import allow_origins
from rce.services.problems import problems
from rce.web.server import Endpoint, listen, serve_application

MAX_BODY = 24 * 1024 * 1024  # bytes of a body that is not streamed: an OWL text with all characters escaped
SHUTDOWN_TIMEOUT = 2.0
ACTIONS = {
    "POST /entries": "knowledge.add",
    "PATCH /entries/{kind}/{uid}": "knowledge.change",
    "DELETE /entries/{kind}/{uid}": "knowledge.remove",
    "POST /entries/{kind}/{uid}/rating": "knowledge.rate",
    "DELETE /entries/{kind}/{uid}/versions/{version}": "knowledge.remove_version",
    "PUT /entries/{kind}/{uid}/files/{file}": "knowledge.put_file",
    "DELETE /entries/{kind}/{uid}/files/{file}": "knowledge.remove_file",
    "POST /archive": "knowledge.import",
}
"""Audited routes."""

log = Logger()


class KnowledgeLimits(Struct, frozen=True):
    """Limits of the knowledge service."""

    repository: RepositoryLimits = RepositoryLimits()
    queries: QueryLimits = QueryLimits()


class KnowledgeService:
    """Repository, queries and the HTTP server in front of them."""

    def __init__(
        self, directory: Path, master: Callable[[], Master], limits: KnowledgeLimits, anonymous: bool = False
    ) -> None:
        """Open the repository in `directory`.

        With `anonymous` clients without credentials may read what is public.

        Raises:
            Unavailable: A newer version of RCE has written the repository.
        """
        self._master = master
        self._reporting: asyncio.Task[None] | None = None
        self.authenticator = Authenticator(master)
        self.repository = Repository(directory, limits.repository, Texts())
        self._removed = RemovedUsers(directory / "removed-users", self.repository.forget)
        self.queries = Queries(self.repository, limits.queries)
        self.environments = Environments(self.repository, self.queries)
        application = web.Application(
            middlewares=[audit_middleware(self.authenticator, PREFIX, ACTIONS), problems], client_max_size=MAX_BODY
        )
        allow_origins(application)
        rest = Rest(self.authenticator, self.repository, self.queries, Archive(self.repository), anonymous)
        openapi.add(application, openapi.routes(rest))
        Original(rest, self.repository, self.queries).add(application)
        health.add(application, self.authenticator)
        self._runner = serve_application(application, shutdown_timeout=SHUTDOWN_TIMEOUT)

    async def start(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> int:
        """Listen for clients; return the port.

        Raises:
            Unavailable: The port cannot be listened on.
        """
        await self.repository.start()
        self._reporting = asyncio.create_task(report_changes(self.repository, self._master))
        _, actual_port = await listen(self._runner, Endpoint(host, port, tls))
        log.info("listening at {host}:{port}{prefix}/", host=host, port=actual_port, prefix=PREFIX)
        return actual_port

    def handlers(self) -> Handlers:
        """Return the handlers for the Master's calls."""
        handlers = Handlers()
        handlers.do(InvalidateAuthentication, lambda call: self.authenticator.invalidate(call.user))
        handlers.on(AnswerKnowledge, self.environments.answer)
        self._removed.add_to(handlers)
        handlers.serve_metrics("knowledge-service")
        return handlers

    async def stop(self) -> None:
        """Stop the HTTP server, then the workers and the database."""
        await self._runner.cleanup()
        if self._reporting is not None:
            self._reporting.cancel()
            await asyncio.gather(self._reporting, return_exceptions=True)
        await self.environments.stop()
        await self.queries.stop()
        await self.repository.stop()

"""`/healthz` and `/readyz` of a service, as the Master has them, without credentials."""

from __future__ import annotations

import msgspec
from aiohttp import web

from rce.services.authentication import Authenticator
from rce.web.health import health


def add(application: web.Application, authenticator: Authenticator) -> None:
    """Add the routes."""

    async def alive(request: web.Request) -> web.Response:
        return _respond([])

    async def ready(request: web.Request) -> web.Response:
        return _respond([] if authenticator.reachable else ["the Master is away: no client can be authenticated"])

    application.router.add_get("/healthz", alive)
    application.router.add_get("/readyz", ready)


def _respond(missing: list[str]) -> web.Response:
    answer, status = health(missing)
    return web.Response(status=status, body=msgspec.json.encode(answer), content_type="application/json")

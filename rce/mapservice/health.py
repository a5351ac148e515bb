"""`/healthz` and `/readyz`, as the Master has them, without credentials."""

from __future__ import annotations

import msgspec
from aiohttp import web
from msgspec import Struct

from rce.mapservice.access import Access


class Health(Struct, frozen=True):
    """`missing` has a sentence for each thing without which no map is made."""

    status: str
    missing: list[str] = []


def add(application: web.Application, access: Access) -> None:
    async def alive(request: web.Request) -> web.Response:
        return _answer([])

    async def ready(request: web.Request) -> web.Response:
        return _answer([] if access.reachable else ["the Master is away: nobody can be let in, and no map is made"])

    application.router.add_get("/healthz", alive)
    application.router.add_get("/readyz", ready)


def _answer(missing: list[str]) -> web.Response:
    health = Health("missing" if missing else "ok", missing)
    status = 503 if missing else 200
    return web.Response(status=status, body=msgspec.json.encode(health), content_type="application/json")

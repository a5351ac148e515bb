"""Health of the map service."""

from __future__ import annotations

from rce.errors import Unavailable
from tests.support.map_service import Service


async def test_health_needs_no_credentials(service: Service) -> None:
    root = service.url.removesuffix("/map-service")
    for path in ("/healthz", "/readyz"):
        async with service.session.get(root + path) as answer:
            assert (answer.status, await answer.json()) == (200, {"status": "ok", "missing": []})
    service.master.failure = Unavailable("no connection")
    async with service.session.get(root + "/readyz") as answer:
        assert answer.status == 503
        assert "Master" in (await answer.json())["missing"][0]

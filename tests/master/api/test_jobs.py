"""Jobs are at the map service."""

from __future__ import annotations

from tests.support.master.served import Served


async def test_jobs_redirect_to_the_map_service(served: Served) -> None:
    assert (await served.ask("GET", "/jobs")).status == 404
    await served.process("service", "map-service", url="http://:9030/")
    answer = await served.ask("GET", "/jobs")
    assert (answer.status, answer.headers["location"]) == (307, "/map-service/jobs")
    assert (await served.ask("GET", "/jobs", "")).status == 401

"""Reports of changes to the Master."""

from __future__ import annotations

import asyncio

from rce.control.calls.knowledge import NotedChange, ReportChanges
from rce.errors import Unavailable
from tests.support.knowledge import Service


def reported(service: Service) -> list[NotedChange]:
    return [each for call in service.master.calls if isinstance(call, ReportChanges) for each in call.changes]


async def until_reported(service: Service, count: int) -> list[NotedChange]:
    async with asyncio.timeout(30):
        while len(reported(service)) < count:  # noqa: ASYNC110  # calls of the fake have no event
            await asyncio.sleep(0.01)
    return reported(service)


async def test_master_is_told_of_each_change_by_whom_and_whether_it_is_public(service: Service) -> None:
    await service.add(id="blue", public=True)
    await service.json("PATCH", "/entries/object/cup.blue", "root", json={"public": False})
    await service.request("DELETE", "/entries/object/cup.blue")
    assert await until_reported(service, 3) == [
        NotedChange("added", "object", "cup.blue", "ann", "ann", True),
        NotedChange("changed", "object", "cup.blue", "ann", "root", False),
        NotedChange("removed", "object", "cup.blue", "ann", "ann", False),
    ]


async def test_reports_go_on_after_the_master_was_away(service: Service) -> None:
    await service.add(id="one")
    await until_reported(service, 1)
    service.master.failure = Unavailable("away")
    await service.add(id="lost")  # the credentials are known by now
    await until_reported(service, 2)
    service.master.failure = None
    await service.add(id="two")
    assert (await until_reported(service, 3))[-1].uid == "cup.two"

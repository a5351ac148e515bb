"""Addresses of services."""

from __future__ import annotations

from tests.support.master.served import Served


async def test_services_that_have_joined_are_listed_with_their_addresses(served: Served) -> None:
    assert (await served.ask("GET", "/services")).body["items"] == []
    await served.process("service", "map-service", url="http://:9030/")
    found = (await served.ask("GET", "/services")).body["items"]
    assert found == [{"name": "map-service", "url": "http://127.0.0.1:9030/map-service"}]

"""Assembly of the knowledge service."""

from __future__ import annotations

from rce.control.calls.services import Authenticate
from rce.errors import Unauthorized
from tests.support.knowledge import Service


async def test_health_needs_no_credentials_and_knows_of_the_master(service: Service) -> None:
    async with service.session.get(service.root + "/readyz") as answer:
        assert answer.status == 200
    service.master.failure = Unauthorized("away")
    async with service.session.get(service.root + "/readyz") as answer:
        assert answer.status == 503


async def test_user_whose_rights_change_is_authenticated_again(service: Service) -> None:
    for _ in range(2):
        await service.json("GET", "/usage")
    assert len([each for each in service.master.calls if isinstance(each, Authenticate)]) == 1
    service.service.authenticator.invalidate("ann")
    await service.json("GET", "/usage")
    assert len([each for each in service.master.calls if isinstance(each, Authenticate)]) == 2

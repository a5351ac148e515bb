"""Service calls of a gateway itself."""

from __future__ import annotations

import asyncio

import pytest

from endpoints.gateways import asker
from endpoints.gateways.asker import MAX_SERVICES, Asker
from rce.errors import RceError, TimedOut
from tests.support.endpoints.fake_guest import FakeGuest
from tests.support.endpoints.raw_robot import eventually

BOOL = "std_srvs/SetBool"


async def test_answer_is_returned_as_json() -> None:
    guest = FakeGuest()
    ask = Asker(guest.as_guest())
    for _ in range(2):
        guest.sent.clear()
        asking = asyncio.create_task(ask("/set", BOOL, b"{}"))
        await eventually(lambda: bool(guest.sent))
        guest.deliver(guest.uses["ServiceClientInterface", "/set"], {"success": True}, guest.sent[0][1])
        assert await asking == b'{"success":true}'
    assert len(guest.options) == 1, "the interface is used again"


async def test_failures_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    guest = FakeGuest()
    guest.refuses = RceError("it is broken")
    with pytest.raises(RceError, match="it is broken"):
        await Asker(guest.as_guest())("/set", BOOL, b"{}")
    guest.refuses = None
    monkeypatch.setattr(asker, "TIMEOUT", 0.01)
    with pytest.raises(TimedOut, match="did not answer"):
        await Asker(guest.as_guest())("/set", BOOL, b"{}")
    guest.fails = RceError("no environment")
    with pytest.raises(RceError, match="no environment"):
        await Asker(guest.as_guest())("/set", BOOL, b"{}")


async def test_service_is_kept_until_its_calls_are_answered() -> None:
    guest = FakeGuest()
    ask, number = Asker(guest.as_guest()), MAX_SERVICES + 20
    calls = [asyncio.create_task(ask(f"/s{each}", BOOL, b"{}")) for each in range(number)]
    for answered in range(number):
        await eventually(lambda wanted=answered: len(guest.sent) > wanted)  # type: ignore[misc]
        assert len(guest.dropped) <= answered
        address, id, *_ = guest.sent[answered]
        guest.deliver(guest.uses["ServiceClientInterface", address], {}, id)
    assert [await call for call in calls] == [b"{}"] * number
    assert len(guest.dropped) == 20


async def test_call_fails_at_once_when_its_service_is_gone() -> None:
    guest = FakeGuest()
    asking = asyncio.create_task(Asker(guest.as_guest())("/set", BOOL, b"{}"))
    await eventually(lambda: bool(guest.sent))
    guest.uses["ServiceClientInterface", "/set"].end(RceError("the robot has taken it back"))
    with pytest.raises(RceError, match="taken it back"):
        await asyncio.wait_for(asking, 5)

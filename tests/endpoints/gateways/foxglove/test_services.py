"""Calls of services by a client of Foxglove."""

from __future__ import annotations

import sys

import pytest

from endpoints.gateways.foxglove.messages import ServiceRequest
from endpoints.gateways.foxglove.offers import Offer
from endpoints.gateways.foxglove.services import Calls
from rce.errors import NotFound, RceError
from tests.support.endpoints.fake_guest import FakeGuest

OFFER = Offer("/set", "std_srvs/SetBool", ("", ""))
CDR = ServiceRequest(1, 10, "cdr", memoryview(b"\0\1\0\0\1"))
JSON = ServiceRequest(1, 11, "json", memoryview(b'{"data":true}'))


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest()


async def test_responses_have_the_encoding_of_their_requests(guest: FakeGuest) -> None:
    calls = Calls(guest.as_guest())
    calls.call(CDR, OFFER)
    await guest.finish()
    by_cdr = guest.uses["ServiceClientInterface", "/set"]
    calls.call(JSON, OFFER)
    await guest.finish()
    by_json = guest.uses["ServiceClientInterface", "/set"]
    (_, first, value, _), (_, second, decoded, _) = guest.sent
    assert (value, decoded) == (b"\0\1\0\0\1", {"data": True})
    (frame,) = guest.deliver(by_cdr, "id", first, blob=b"answer")
    assert frame.endswith(b"cdranswer")
    (frame,) = guest.deliver(by_json, {"success": True}, second)
    assert frame.endswith(b'json{"success":true}')
    assert guest.deliver(by_json, {}, second) == []


async def test_failures_name_the_call(guest: FakeGuest) -> None:
    calls = Calls(guest.as_guest())
    calls.call(CDR, None)
    calls.call(ServiceRequest(1, 12, "ros1", memoryview(b"")), OFFER)
    guest.fails = RceError("no environment")
    calls.call(JSON, OFFER)
    await guest.finish()
    assert [(each["op"], each["callId"]) for each in guest.frames] == [
        ("serviceCallFailure", 10),
        ("serviceCallFailure", 12),
        ("serviceCallFailure", 11),
    ]


async def test_unanswered_call_does_not_keep_its_request(guest: FakeGuest) -> None:
    payload = bytes(1000)
    before = sys.getrefcount(payload)
    calls = Calls(guest.as_guest())
    calls.call(ServiceRequest(1, 10, "cdr", memoryview(payload)), OFFER)
    await guest.finish()
    assert len(calls._calls) == 1
    assert sys.getrefcount(payload) == before


async def test_calls_end_with_the_use_of_their_service(guest: FakeGuest) -> None:
    calls = Calls(guest.as_guest())
    calls.call(CDR, OFFER)
    await guest.finish()
    guest.uses["ServiceClientInterface", "/set"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert [(each["callId"], each["message"]) for each in guest.frames] == [(10, "the robot removed it")]
    calls.call(CDR, OFFER)
    await guest.finish()
    assert len(guest.options) == 2, "the service is used anew"


async def test_service_that_has_another_type_now_is_used_with_it(guest: FakeGuest) -> None:
    calls = Calls(guest.as_guest())
    calls.call(CDR, OFFER)
    calls.call(CDR, OFFER._replace(type="std_srvs/Empty"))
    await guest.finish()
    assert guest.uses["ServiceClientInterface", "/set"].type == "std_srvs/Empty"


async def test_call_fails_while_too_much_is_in_progress(guest: FakeGuest) -> None:
    calls = Calls(guest.as_guest())
    guest.full = True
    calls.call(CDR, OFFER)
    assert [each["callId"] for each in guest.frames] == [10]
    assert not calls._calls

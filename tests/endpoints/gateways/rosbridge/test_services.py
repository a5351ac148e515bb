"""Services that a client of rosbridge calls and serves."""

from __future__ import annotations

import asyncio

import cbor2
import pytest
from msgspec import Raw

from endpoints.gateways.rosbridge.operations import (
    AdvertiseService,
    CallService,
    ServiceResponse,
    UnadvertiseService,
)
from endpoints.gateways.rosbridge.services import MAX_TIMEOUT, ServedServices, ServiceCalls, find_service_type
from endpoints.robot.services import MAX_PENDING
from rce.control.calls.watching import RosGraph, RosName
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from tests.support.endpoints.fake_guest import FakeGuest, FakePeer
from tests.support.endpoints.raw_robot import eventually

BOOL = "std_srvs/SetBool"
ID = Raw(b'"call"')
CALL = CallService(service="/set", id=ID, args=Raw(b'{"data":true}'))


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest(RosGraph([], [RosName("/set", [BOOL])]))


@pytest.fixture
def calls(guest: FakeGuest) -> ServiceCalls:
    return ServiceCalls(guest.as_guest(), FakePeer())


@pytest.fixture
def served(guest: FakeGuest) -> ServedServices:
    return ServedServices(guest.as_guest(), FakePeer())


async def test_answer_has_the_id_of_the_call(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CALL)
    await guest.finish()
    ((_, number, request, _),) = guest.sent
    assert request == {"data": True}
    use = guest.uses["ServiceClientInterface", "/set"]
    answer = {"op": "service_response", "service": "/set", "result": True, "id": "call", "values": {"success": True}}
    assert guest.deliver(use, {"success": True}, number) == [answer]
    assert guest.deliver(use, {}, number) == [], "answered already"
    calls.call(CALL)
    await guest.finish()
    assert len(guest.options) == 1, "the interface is used again"


async def test_arguments_may_be_a_list(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CallService(service="/set", args=Raw(b"[true]")))
    await guest.finish()
    assert guest.sent[0][2] == {"data": True}


async def test_answer_may_be_cbor(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CallService(service="/set", id=ID, compression="cbor"))
    await guest.finish()
    use = guest.uses["ServiceClientInterface", "/set"]
    (frame,) = guest.deliver(use, "id", guest.sent[0][1], blob=cbor2.dumps({"success": False}))
    assert cbor2.loads(frame)["values"] == {"success": False}
    assert cbor2.loads(frame)["id"] == "call"


async def test_failed_call_is_answered_with_the_reason(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CallService(service="/nothing", id=ID))
    guest.refuses = RceError("it is broken")
    calls.call(CALL)
    await guest.finish()
    calls.call(CallService(service="/set", timeout=0.01))
    guest.refuses = None
    await eventually(lambda: len(guest.frames) == 3)
    assert [each["result"] for each in guest.frames] == [False] * 3
    assert {each["values"] for each in guest.frames} == {
        "service /nothing does not exist",
        "it is broken",
        "Timeout exceeded while waiting for service response",
    }


async def test_unanswered_calls_are_bounded(guest: FakeGuest, calls: ServiceCalls) -> None:
    for _ in range(MAX_PENDING + 1):
        calls.call(CALL)
    await guest.finish()
    assert [each["result"] for each in guest.frames] == [False]


async def test_client_serves_a_service(guest: FakeGuest, served: ServedServices) -> None:
    served.advertise(AdvertiseService(service="/give", type=BOOL))
    use = guest.uses["ServiceProviderInterface", "/give"]
    (request,) = guest.deliver(use, {"data": True}, "n1")
    assert (request["op"], request["args"]) == ("call_service", {"data": True})
    id = Raw(b'"%b"' % request["id"].encode())
    served.respond(ServiceResponse(service="/give", id=id, values=Raw(b'{"success":true}')))
    assert guest.sent == [("/give", "n1", {"success": True}, {})]
    with pytest.raises(InvalidRequest, match="no unanswered call"):
        served.respond(ServiceResponse(service="/give", id=id))
    (request,) = guest.deliver(use, {}, "n2")
    id = Raw(b'"%b"' % request["id"].encode())
    served.respond(ServiceResponse(service="/give", id=id, values=Raw(b'"no"'), result=False))
    assert guest.sent[1:] == [("/give", "n2", {}, {"error": "no"})]
    (request,) = guest.deliver(use, {}, "n3")
    id = Raw(b'"%b"' % request["id"].replace("/", "\\/").encode())  # as some encoders write it
    served.respond(ServiceResponse(service="/give", id=id))
    assert guest.sent[2:] == [("/give", "n3", {}, {})]
    (request,) = guest.deliver(use, {}, "n4")
    id = Raw(b'"%b"' % request["id"].encode())
    with pytest.raises(InvalidRequest, match="malformed"):
        served.respond(ServiceResponse(service="/give", id=id, values=Raw(b'"\xff"'), result=False))
    served.unadvertise(UnadvertiseService(service="/give"))
    assert guest.dropped == ["/give"]


async def test_type_comes_from_the_graph(guest: FakeGuest) -> None:
    assert await find_service_type(guest.as_guest(), "/set") == BOOL
    with pytest.raises(NotFound):
        await find_service_type(guest.as_guest(), "/get")


async def test_calls_of_a_service_that_is_dropped_for_another_are_answered(
    guest: FakeGuest, calls: ServiceCalls
) -> None:
    calls.call(CALL)
    await guest.finish()
    calls.call(CallService(service="/set", type="std_srvs/Empty"))
    await guest.finish()
    assert guest.dropped == ["/set"]
    assert [(each["id"], each["result"]) for each in guest.frames] == [("call", False)]


async def test_calls_of_a_client_that_left_keep_no_timer(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CallService(service="/set", timeout=1e300))
    (call,) = calls._calls.values()
    timer = call.timer
    assert timer is not None
    assert timer.when() <= asyncio.get_running_loop().time() + MAX_TIMEOUT + 1
    calls.close()
    await guest.finish()
    assert timer.cancelled()
    assert guest.frames == []


async def test_calls_end_with_the_use_of_their_service(guest: FakeGuest, calls: ServiceCalls) -> None:
    calls.call(CALL)
    await guest.finish()
    guest.uses["ServiceClientInterface", "/set"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert [(each["result"], each["values"]) for each in guest.frames] == [(False, "the robot removed it")]
    calls.call(CALL)
    await guest.finish()
    assert len(guest.options) == 2, "the service is used anew"


async def test_call_is_answered_although_too_much_is_in_progress(guest: FakeGuest, calls: ServiceCalls) -> None:
    guest.full = True
    calls.call(CALL)
    assert [(each["id"], each["result"]) for each in guest.frames] == [("call", False)]
    assert not calls._calls


async def test_service_is_kept_if_its_successor_is_refused(guest: FakeGuest, served: ServedServices) -> None:
    served.advertise(AdvertiseService(service="/give", type=BOOL))
    guest.full = True
    with pytest.raises(LimitExceeded):
        served.advertise(AdvertiseService(service="/give", type=BOOL))
    assert guest.dropped == []


async def test_service_that_ended_is_reported_and_served_no_more(guest: FakeGuest) -> None:
    peer = FakePeer()
    served = ServedServices(guest.as_guest(), peer)
    served.advertise(AdvertiseService(service="/give", type=BOOL, id=ID))
    guest.uses["ServiceProviderInterface", "/give"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert peer.errors == [("the robot removed it", "call")]
    served.unadvertise(UnadvertiseService(service="/give"))
    assert guest.dropped == []

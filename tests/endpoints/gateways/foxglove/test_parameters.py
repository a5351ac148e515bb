"""Parameters for a client of Foxglove."""

from __future__ import annotations

import asyncio
from typing import Any

import msgspec
import pytest

from endpoints.gateways.foxglove.messages import Parameter
from endpoints.gateways.foxglove.parameters import MAX_NAME, MAX_WANTED, ClientParameters
from rce.control.calls.watching import RosGraph, RosName
from rce.errors import LimitExceeded, RceError
from tests.support.endpoints.fake_guest import FakeGuest, FakePeer


@pytest.fixture
def values() -> dict[str, Any]:
    return {"rate": {"type": 3, "double_value": 2.0}}


@pytest.fixture
def parameters(guest: FakeGuest, peer: FakePeer, values: dict[str, Any]) -> ClientParameters:
    made = ClientParameters(guest.as_guest(), peer.report)

    async def ask(service: str, type: str, args: bytes) -> bytes:
        wanted = msgspec.json.decode(args)
        if type.endswith("GetParameters"):
            return msgspec.json.encode({"values": [values.get(name, {"type": 0}) for name in wanted["names"]]})
        values.update({each["name"]: each["value"] for each in wanted["parameters"]})
        return msgspec.json.encode({"results": [{"successful": True, "reason": ""}]})

    made._parameters._ask = ask  # type: ignore[assignment]
    guest.ros = RosGraph([], [RosName(f"/n/{each}_parameters", []) for each in ("get", "set", "list")])
    return made


async def test_values_are_sent_with_the_id(guest: FakeGuest, parameters: ClientParameters) -> None:
    await parameters.get(["/n.rate", "/n.none"], "x")
    record = {"name": "/n.rate", "value": 2.0, "type": "float64"}
    assert guest.frames == [{"op": "parameterValues", "parameters": [record], "id": "x"}]


async def test_whole_number_may_be_set_as_a_float(
    guest: FakeGuest, peer: FakePeer, parameters: ClientParameters, values: dict[str, Any]
) -> None:
    await parameters.set([Parameter("/n.rate", 3, "float64"), Parameter("/n.bad", "x", "float64")], None)
    assert values["rate"] == {"type": 3, "double_value": 3.0}
    assert len(peer.errors) == 1
    assert not guest.frames


async def test_changes_are_sent_for_what_was_subscribed_to(guest: FakeGuest, parameters: ClientParameters) -> None:
    parameters.subscribe(["/n.rate", "/n.gone"])
    use = guest.uses["SubscriberInterface", "/parameter_events"]
    changed = [{"name": "rate", "value": {"type": 2, "integer_value": 1}}, {"name": "other", "value": {"type": 0}}]
    event = {
        "node": "/n",
        "new_parameters": [],
        "changed_parameters": changed,
        "deleted_parameters": [{"name": "gone"}],
    }
    (message,) = guest.deliver(use, event)
    assert message["parameters"] == [{"name": "/n.rate", "value": 1}, {"name": "/n.gone"}]
    assert guest.deliver(use, event | {"node": "/m"}) == []
    parameters.unsubscribe(["/n.rate", "/n.gone"])
    assert guest.dropped == ["/parameter_events"]


async def test_names_that_are_subscribed_to_are_bounded(parameters: ClientParameters) -> None:
    parameters.subscribe([f"/n.{number}" for number in range(MAX_WANTED)])
    for names in (["/n.more"], ["x" * (MAX_NAME + 1)]):
        with pytest.raises(LimitExceeded):
            parameters.subscribe(names)


async def test_number_that_no_float_holds_is_refused(peer: FakePeer, parameters: ClientParameters) -> None:
    await parameters.set([Parameter("/n.rate", 10**400, "float64")], None)
    assert len(peer.errors) == 1


async def test_changes_may_be_asked_for_again_after_a_failure(
    guest: FakeGuest, peer: FakePeer, parameters: ClientParameters
) -> None:
    guest.full = True
    with pytest.raises(LimitExceeded):
        parameters.subscribe(["/n.rate"])
    guest.full = False
    guest.fails = RceError("no environment")
    parameters.subscribe(["/n.rate"])
    await guest.finish()
    assert peer.errors == [("no environment", None)]
    guest.fails = None
    parameters.subscribe(["/n.rate"])
    assert len(guest.options) == 2


async def test_failure_of_a_use_that_was_given_up_changes_nothing(
    guest: FakeGuest, peer: FakePeer, parameters: ClientParameters
) -> None:
    guest.auto = False
    parameters.subscribe(["/n.rate"])
    first = guest.uses["SubscriberInterface", "/parameter_events"]
    parameters.unsubscribe(["/n.rate"])
    parameters.subscribe(["/n.rate"])
    first.end(RceError("no environment"))
    await guest.finish()
    assert peer.errors == []
    parameters.subscribe(["/n.other"])
    assert len(guest.options) == 2


async def test_names_are_sent_as_the_client_writes_them(guest: FakeGuest, parameters: ClientParameters) -> None:
    await parameters.get(["n.rate"], "x")
    assert guest.frames[0]["parameters"] == [{"name": "n.rate", "value": 2.0, "type": "float64"}]
    parameters.subscribe(["n.rate"])
    use = guest.uses["SubscriberInterface", "/parameter_events"]
    changed = [{"name": "rate", "value": {"type": 2, "integer_value": 1}}]
    event = {"node": "/n", "new_parameters": [], "changed_parameters": changed, "deleted_parameters": []}
    (message,) = guest.deliver(use, event)
    assert message["parameters"] == [{"name": "n.rate", "value": 1}]
    parameters.unsubscribe(["n.rate"])
    assert guest.dropped == ["/parameter_events"]


async def test_values_are_read_after_they_were_set(guest: FakeGuest, parameters: ClientParameters) -> None:
    await asyncio.gather(parameters.set([Parameter("/n.rate", 3, "float64")], None), parameters.get(["/n.rate"], "x"))
    assert guest.frames[0]["parameters"][0]["value"] == 3.0

"""Goals that a client of rosbridge sends and carries out."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec import Raw

from endpoints.gateways.rosbridge.actions import SentGoals, ServedActions, find_action_type
from endpoints.gateways.rosbridge.operations import (
    ActionFeedback,
    ActionResult,
    AdvertiseAction,
    CancelActionGoal,
    SendActionGoal,
    UnadvertiseAction,
)
from rce.control.calls.watching import RosAction, RosGraph
from rce.errors import InvalidRequest, LimitExceeded, NotFound, RceError
from tests.support.endpoints.fake_guest import FakeGuest, FakePeer

TYPE = "example_interfaces/Fibonacci"
ID = Raw(b'"goal"')


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest(RosGraph([], [], [RosAction("/f", [TYPE])]))


@pytest.fixture
def peer() -> FakePeer:
    return FakePeer()


@pytest.fixture
def goals(guest: FakeGuest, peer: FakePeer) -> SentGoals:
    return SentGoals(guest.as_guest(), peer)


@pytest.fixture
def served(guest: FakeGuest, peer: FakePeer) -> ServedActions:
    return ServedActions(guest.as_guest(), peer)


async def send(guest: FakeGuest, goals: SentGoals, **more: Any) -> tuple[Any, str]:
    """Send a goal; return the use and the goal's UUID."""
    goals.send(SendActionGoal(action="/f", action_type=TYPE, id=ID, args=Raw(b'{"order":3}'), **more))
    await guest.finish()
    _, uuid, request, fields = guest.sent[-1]
    assert (request, fields["phase"]) == ({"order": 3}, "goal")
    return guest.uses["ActionClientInterface", "/f"], uuid


async def test_feedback_and_result_have_the_id_of_the_goal(guest: FakeGuest, goals: SentGoals) -> None:
    use, uuid = await send(guest, goals, feedback=True)
    assert guest.deliver(use, {}, uuid, phase="accepted") == []
    (feedback,) = guest.deliver(use, {"sequence": [0]}, uuid, phase="feedback")
    assert feedback == {"op": "action_feedback", "action": "/f", "id": "goal", "values": {"sequence": [0]}}
    (result,) = guest.deliver(use, {"sequence": [0, 1]}, uuid, phase="result", status="succeeded")
    assert (result["status"], result["result"], result["values"]) == (4, True, {"sequence": [0, 1]})
    assert guest.deliver(use, {}, uuid, phase="feedback") == []


async def test_feedback_is_sent_only_if_it_was_asked_for(guest: FakeGuest, goals: SentGoals) -> None:
    use, uuid = await send(guest, goals)
    assert guest.deliver(use, {}, uuid, phase="feedback") == []


async def test_goal_is_canceled_once_it_is_accepted(guest: FakeGuest, goals: SentGoals) -> None:
    use, uuid = await send(guest, goals)
    goals.cancel(CancelActionGoal(action="/f", id=ID))
    assert len(guest.sent) == 1
    guest.deliver(use, {}, uuid, phase="accepted")
    assert guest.sent[1] == ("/f", uuid, {}, {"phase": "cancel"})
    (result,) = guest.deliver(use, {}, uuid, phase="result", status="canceled")
    assert (result["status"], result["result"]) == (5, True)
    with pytest.raises(NotFound, match="no unfinished goal"):
        goals.cancel(CancelActionGoal(action="/f", id=ID))


async def test_goal_that_is_rejected_or_fails_has_no_result(guest: FakeGuest, peer: FakePeer, goals: SentGoals) -> None:
    use, uuid = await send(guest, goals)
    guest.deliver(use, {}, uuid, phase="rejected")
    _, uuid = await send(guest, goals)
    use.failed(uuid, RceError("not canceled").with_fields(phase="cancel"))
    assert peer.errors == [("not canceled", None)]
    use.failed(uuid, RceError("the server is gone"))
    goals.send(SendActionGoal(action="/nothing"))
    await guest.finish()
    assert [(each["result"], each["values"]) for each in guest.frames] == [
        (False, "action /f rejected the goal"),
        (False, "the server is gone"),
        (False, "action /nothing does not exist"),
    ]


async def test_client_carries_out_goals(guest: FakeGuest, served: ServedActions) -> None:
    served.advertise(AdvertiseAction(action="/g", type=TYPE))
    use = guest.uses["ActionProviderInterface", "/g"]
    (request,) = guest.deliver(use, {"order": 2}, "a" * 32, phase="goal")
    assert (request["op"], request["args"], request["action_type"]) == ("send_action_goal", {"order": 2}, TYPE)
    id = Raw(b'"%b"' % request["id"].encode())
    served.feedback(ActionFeedback(action="/g", id=id, values=Raw(b'{"sequence":[1]}')))
    (cancel,) = guest.deliver(use, {}, "a" * 32, phase="cancel")
    assert cancel == {"op": "cancel_action_goal", "id": request["id"], "action": "/g"}
    served.result(ActionResult(action="/g", id=id, status=5, values=Raw(b'{"sequence":[]}')))
    served.result(ActionResult(action="/g", id=id, result=False))
    assert [fields for *_, fields in guest.sent] == [
        {"phase": "accepted"},
        {"phase": "feedback"},
        {"phase": "cancel"},
        {"phase": "result", "status": "canceled"},
        {"phase": "result", "status": "aborted"},
    ]
    assert {uuid for _, uuid, *_ in guest.sent} == {"a" * 32}
    with pytest.raises(InvalidRequest, match="status 2"):
        served.result(ActionResult(action="/g", id=id, status=2))
    served.unadvertise(UnadvertiseAction(action="/g"))
    with pytest.raises(InvalidRequest, match="not advertised"):
        served.feedback(ActionFeedback(action="/g", id=id))


async def test_type_comes_from_the_graph(guest: FakeGuest) -> None:
    assert await find_action_type(guest.as_guest(), "/f") == TYPE
    with pytest.raises(NotFound):
        await find_action_type(guest.as_guest(), "/g")


async def test_action_of_two_types_has_one_use_for_each(guest: FakeGuest, goals: SentGoals) -> None:
    for _ in range(2):
        await send(guest, goals)
        goals.send(SendActionGoal(action="/f", action_type="other_msgs/F"))
        await guest.finish()
    assert len(guest.options) == 2


async def test_goals_end_with_the_use_of_their_action(guest: FakeGuest, goals: SentGoals) -> None:
    use, _ = await send(guest, goals)
    use.end(NotFound("the robot removed it"))
    await guest.finish()
    assert [(each["result"], each["values"]) for each in guest.frames] == [(False, "the robot removed it")]
    await send(guest, goals)
    assert len(guest.options) == 2, "the action is used anew"


async def test_goal_is_answered_although_too_much_is_in_progress(guest: FakeGuest, goals: SentGoals) -> None:
    guest.full = True
    goals.send(SendActionGoal(action="/f", action_type=TYPE, id=ID))
    assert [(each["id"], each["result"]) for each in guest.frames] == [("goal", False)]
    assert not goals._goals


async def test_action_is_kept_if_its_successor_is_refused(guest: FakeGuest, served: ServedActions) -> None:
    served.advertise(AdvertiseAction(action="/f", type=TYPE))
    guest.full = True
    with pytest.raises(LimitExceeded):
        served.advertise(AdvertiseAction(action="/f", type=TYPE))
    assert guest.dropped == []


async def test_action_that_ended_is_reported_and_carried_out_no_more(
    guest: FakeGuest, peer: FakePeer, served: ServedActions
) -> None:
    served.advertise(AdvertiseAction(action="/f", type=TYPE, id=ID))
    guest.uses["ActionProviderInterface", "/f"].end(NotFound("the robot removed it"))
    await guest.finish()
    assert peer.errors == [("the robot removed it", "goal")]
    with pytest.raises(InvalidRequest, match="not advertised"):
        served.feedback(ActionFeedback(action="/f", id=ID))

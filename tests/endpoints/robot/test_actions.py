"""Actions between two robots, one that asks and one that carries out goals, as frames."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import pytest

from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import Json, Robot, status

TYPE = "example_interfaces/Fibonacci"
GOAL, OTHER = "1a" * 16, "2b" * 16


class Pair(NamedTuple):
    """Two robots with connected interfaces for an action."""

    asker: Robot
    worker: Robot

    async def ask(self, phase: str, id: str = GOAL, **more: Any) -> None:
        await self.asker.send(frame("ask", phase, id, **more))

    async def report(self, phase: str, id: str = GOAL, **more: Any) -> None:
        await self.worker.send(frame("act", phase, id, **more))


def frame(tag: str, phase: str, id: str = GOAL, **more: Any) -> Json:
    return {"type": "DM", "data": {"iTag": tag, "type": TYPE, "msgID": id, "phase": phase, **more}}


def got(tag: str, phase: str, msg: Any = None, **more: Any) -> Json:
    return frame(tag, phase, msg=msg or {}, **more)


async def pair(platform: Platform, suffix: str) -> Pair:
    asker, worker = await platform.robot("asker", "events"), await platform.robot("worker", "events")
    for robot in (asker, worker):
        await robot.receive()
    await asker.add("ask", f"ActionProvider{suffix}", TYPE)
    await asker.add("act", f"ActionClient{suffix}", TYPE, of="worker")
    await asker.connect("asker/ask", "worker/act")
    assert await asker.receive() == status("ask", True)
    assert await worker.receive() == status("act", True)
    return Pair(asker, worker)


@pytest.fixture
async def robots(platform: Platform) -> Pair:
    return await pair(platform, "Converter")


async def test_goal_passes_through_all_phases(robots: Pair) -> None:
    await robots.ask("goal", msg={"order": 2})
    assert await robots.worker.receive() == got("act", "goal", {"order": 2})
    await robots.report("accepted")
    await robots.report("feedback", msg={"sequence": [0]})
    await robots.report("result", status="succeeded", msg={"sequence": [0, 1]})
    assert await robots.asker.receive_all(3) == [
        got("ask", "accepted"),
        got("ask", "feedback", {"sequence": [0]}),
        got("ask", "result", {"sequence": [0, 1]}, status="succeeded"),
    ]


async def test_goal_is_canceled_and_its_result_has_defaults(robots: Pair) -> None:
    await robots.ask("goal")
    assert await robots.worker.receive() == got("act", "goal", {"order": 0})
    await robots.report("accepted")
    await robots.ask("cancel")
    assert await robots.worker.receive() == got("act", "cancel")
    await robots.report("cancel")
    await robots.report("result", status="canceled")
    assert await robots.asker.receive_all(3) == [
        got("ask", "accepted"),
        got("ask", "cancel"),
        got("ask", "result", {"sequence": []}, status="canceled"),
    ]


async def test_rejected_goal_is_over(robots: Pair) -> None:
    await robots.ask("goal")
    await robots.report("rejected")
    assert await robots.asker.receive() == got("ask", "rejected")
    await robots.worker.receive()
    await robots.report("result", status="succeeded")
    assert (await robots.worker.receive())["error"]["code"] == "not_found"


async def test_failed_goal_and_refused_cancellation_are_reported_with_the_goals_id(robots: Pair) -> None:
    await robots.ask("goal")
    await robots.report("accepted")
    await robots.report("cancel", error="not now")
    await robots.report("result", status="aborted", error="broken")
    _, refused, failed = await robots.asker.receive_all(3)
    assert refused["error"]["fields"] == {"iTag": "ask", "msgID": GOAL, "phase": "cancel"}
    assert "not now" in refused["error"]["message"]
    assert failed["error"]["fields"] == {"iTag": "ask", "msgID": GOAL}
    assert "broken" in failed["error"]["message"]


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"phase": "goal", "msgID": "nil"}, "msgID"),
        ({"phase": "accepted"}, "phase"),
        ({"phase": ""}, "phase"),
        ({"phase": "other"}, "phase"),
        ({"phase": "goal", "msg": {"order": "many"}}, "order"),
    ],
)
async def test_wrong_message_of_the_asker_is_refused(robots: Pair, wrong: Json, field: str) -> None:
    await robots.asker.send({"type": "DM", "data": {"iTag": "ask", "type": TYPE, "msgID": GOAL, **wrong}})
    error = await robots.asker.receive()
    assert field in error["error"]["field"]
    await robots.ask("goal")
    assert (await robots.worker.receive())["data"]["phase"] == "goal", "its id is not in use"


@pytest.mark.parametrize("wrong", [{"phase": "goal"}, {"phase": "result"}, {"phase": "result", "status": "done"}])
async def test_wrong_message_of_the_worker_is_refused(robots: Pair, wrong: Json) -> None:
    await robots.ask("goal")
    await robots.worker.receive()
    await robots.worker.send({"type": "DM", "data": {"iTag": "act", "type": TYPE, "msgID": GOAL, **wrong}})
    assert (await robots.worker.receive())["type"] == "ER"


@pytest.mark.parametrize(("if_lost", "phases"), [("cancel", ["cancel"]), ("leave", [])])
async def test_goal_of_a_robot_that_is_lost_is_canceled_if_it_asked_for_that(
    platform: Platform, robots: Pair, if_lost: str, phases: list[str]
) -> None:
    await robots.ask("goal", ifLost=if_lost)
    await robots.worker.receive()
    await robots.report("accepted")
    await robots.asker.receive()
    await platform.forget("asker")
    frames = await robots.worker.until(lambda frame: frame["data"] == status("act", False)["data"])
    assert [each["data"]["phase"] for each in frames if each["type"] == "DM"] == phases


async def test_goals_of_a_worker_that_is_lost_fail(platform: Platform, robots: Pair) -> None:
    await robots.ask("goal")
    await robots.report("accepted")
    await robots.asker.receive()
    await platform.forget("worker")
    frames = await robots.asker.until(lambda frame: frame["type"] == "ER")
    assert frames[-1]["error"]["code"] == "not_connected"
    assert frames[-1]["error"]["fields"]["msgID"] == GOAL


async def test_result_is_asked_for_again(robots: Pair) -> None:
    await robots.ask("goal")
    await robots.report("accepted")
    await robots.report("result", status="aborted", msg={"sequence": [7]})
    await robots.asker.receive_all(2)
    await robots.ask("result")
    assert await robots.asker.receive() == got("ask", "result", {"sequence": [7]}, status="aborted")
    await robots.ask("result", OTHER)
    assert (await robots.asker.receive())["error"]["code"] == "not_found"


async def test_forwarders_pass_blobs_unchanged(platform: Platform) -> None:
    robots = await pair(platform, "Forwarder")
    blob = b"\0\1\0\0\5\0\0\0"
    await robots.asker.send(json.dumps(frame("ask", "goal", **{"msg*": OTHER})), OTHER.encode() + blob)
    asked, sent = await robots.worker.receive_all(2)
    assert (asked["data"]["phase"], sent[32:]) == ("goal", blob)
    await robots.report("accepted")
    await robots.report("result", status="canceled")
    assert await robots.asker.receive_all(2) == [got("ask", "accepted"), got("ask", "result", status="canceled")]

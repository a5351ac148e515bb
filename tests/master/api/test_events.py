"""Events over HTTP: a client that reconnects with the id of its last event misses none."""

from __future__ import annotations

import pytest

from master.live import events
from rce.api.roles import Scopes
from rce.control.calls.endpoints import NodeDied
from rce.control.calls.environments import EnvironmentDied, LimitReached
from rce.control.calls.knowledge import NotedChange
from rce.protocol import messages as m
from tests.support.master.served import Served
from tests.support.master.sse import follow


@pytest.fixture
async def served(served: Served) -> Served:
    await served.robot("ann", "r1")
    return served


async def test_events_are_sent(served: Served) -> None:
    follower = await follow(served, "/events", "ann")
    run = served.master.commands.execute
    await run("bob", m.CreateContainer("other"))
    await run("ann", m.CreateContainer("brain", m.ContainerData(restart="no")))
    ready = await follower.next()
    assert (ready["type"], ready["user"], ready["object"]) == ("environment.ready", "ann", "ann/brain")
    await run("ann", m.AddNode("brain", "n", "demo", "talker"))
    await served.call_master("ann/brain", NodeDied("n", -11, ["Segmentation fault"]))
    died = await follower.next()
    assert (died["type"], died["object"], died["status"]) == ("node.died", "ann/brain/n", -11)
    assert died["lines"] == ["Segmentation fault"]
    await run("ann", m.AddInterface("brain", "out", "SubscriberInterface", "std_msgs/String"))
    await run("ann", m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"))
    await run("ann", m.Connect("brain/out", "r1/in"))
    life = served.master.state.environments["ann/brain"].run
    await served.call_master("m1", LimitReached("ann/brain", life, "out of memory"))
    await served.master.sessions.disconnect("ann/r1", "")
    assert await follower.types(4) == ["connection.made", "limit.reached", "connection.gone", "robot.left"]
    await served.call_master("m1", EnvironmentDied("ann/brain", life, "ended with status 1"))
    assert await follower.types(2) == ["environment.gone", "environment.lost"]
    await follower.close()


async def test_client_continues_after_its_last_event(served: Served) -> None:
    first = await follow(served, "/events?type=environment", "ann")
    for tag in ("a", "b", "c"):
        await served.master.commands.execute("ann", m.CreateContainer(tag))
    last = (await first.next())["id"]
    await first.close()
    second = await follow(served, "/events?type=environment.ready", "ann", Last_Event_ID=last)
    assert [(await second.next())["object"] for _ in range(2)] == ["ann/b", "ann/c"]
    await second.close()
    third = await follow(served, "/events", "ann", Last_Event_ID="0badcafe-7")  # of an earlier run of the Master
    assert await third.types(3) == ["missed", "robot.came", "environment.ready"]
    await third.close()


async def test_evicted_events_are_reported_as_missed(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "MAX_EVENTS", 3)
    follower = await follow(served, "/events", "ann")
    log = served.master.events
    reading = log.follow(log.position(""))
    for tag in ("a", "b", "c", "d", "e"):
        log.status_sent("ann", m.EnvironmentEvent(tag, "ready"))
    seen = [await anext(reading) for _ in range(4)]
    assert [each.object for each in seen] == ["", "ann/c", "ann/d", "ann/e"]
    assert seen[0].type == "missed"
    log.status_sent("ann", m.EnvironmentEvent("f", "ready"))
    assert (await anext(reading)).object == "ann/f"
    await reading.aclose()  # type: ignore[attr-defined]
    await follower.close()


async def test_users_get_events_of_what_they_may_see(served: Served) -> None:
    bob, tied = await follow(served, "/events?user=*", "bob"), Scopes(robot="r9", environments=["b"])
    olga, key = await follow(served, "/events?user=*", "olga"), await follow(served, "/events", "ann", tied)
    for user, tag in (("ann", "a"), ("ann", "b"), ("bob", "c")):
        await served.master.commands.execute(user, m.CreateContainer(tag))
    await served.process("container", "m2", capacity=1)
    assert (await bob.next())["object"] == "bob/c"
    assert (await key.next())["object"] == "ann/b"
    assert [(await olga.next())["object"] for _ in range(4)] == ["ann/a", "ann/b", "bob/c", "m2"]
    for follower in (bob, olga, key):
        await follower.close()


async def test_public_changes_of_knowledge_are_told_to_everybody(served: Served) -> None:
    bob = await follow(served, "/events?type=knowledge", "bob")
    ann = await follow(served, "/events?type=knowledge", "ann")
    private = NotedChange("added", "object", "cup.red", "ann", "ann", False)
    public = NotedChange("added", "object", "cup.blue", "ann", "ann", True)
    served.master.events.knowledge_changed([private, public])
    assert (await bob.next())["object"] == "ann/object/cup.blue"
    assert [(await ann.next())["object"] for _ in range(2)] == ["ann/object/cup.red", "ann/object/cup.blue"]
    await bob.close()
    await ann.close()

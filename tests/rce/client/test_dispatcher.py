"""Distribution of statuses and errors to event streams."""

from __future__ import annotations

import gc

from rce.client.declarations import Declarations
from rce.client.dispatcher import EVENT_BACKLOG, Dispatcher
from rce.errors import RceError
from rce.protocol.messages import Connect, ConnectionEvent, DropEvent, EnvironmentEvent, LimitEvent, NodeEvent
from tests.support.client_contract import STRING
from tests.support.fake_platform import FakePlatform


async def test_status_frames_become_events_and_unknown_topics_are_ignored(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        streams = a.events(), a.events()
        await fake.send_status("a", topic="environment", containerTag="brain", state="lost", reason="killed")
        await fake.send_status("a", topic="weather", sunny=True)
        await fake.send_status("a", topic="node", containerTag="brain", nodeTag="n", status=-9, lines=["x"])
        await fake.send_status("a", topic="drops", iTag="out", count=3, where="robot")
        await fake.send_status("a", topic="limit", reason="too much")
        for stream in streams:
            assert await stream.get(10) == EnvironmentEvent("brain", "lost", "killed")
            assert await stream.get(10) == NodeEvent("brain", "n", -9, ["x"])
            assert await stream.get(10) == DropEvent("out", 3, "robot")
            assert await stream.get(10) == LimitEvent("too much")


async def test_connection_that_is_gone_is_not_declared_again() -> None:
    declarations = Declarations("a")
    for command in (Connect("a/out", "b/in"), Connect("a/out", "b/more")):
        declarations.record(command)
    dispatcher = Dispatcher("a", declarations)
    dispatcher.status_received(ConnectionEvent("b/in", "a/out", "gone"))
    dispatcher.status_received(ConnectionEvent("a/out", "b/more", "waiting"))
    assert [*dispatcher.declarations()] == [Connect("a/out", "b/more")]


async def test_error_that_answers_no_command_is_an_event(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        events = a.events()
        publisher = await a.publisher("out", STRING)
        subscriber = await a.subscriber("in", STRING, to="a/out")
        fake.interfaces["a/out"] = fake.interfaces["a/out"] | {"className": "std_msgs/Int8"}
        await publisher.publish({"data": "x"})
        error = await events.get(10)
        assert isinstance(error, RceError)
        assert "another type" in str(error)
        assert subscriber.connected


async def test_stream_keeps_a_bounded_number_of_unread_events() -> None:
    dispatcher = Dispatcher("a", Declarations("a"))
    events = dispatcher.events()
    for number in range(EVENT_BACKLOG + 2):
        dispatcher.status_received(LimitEvent(str(number)))
    assert events.dropped == 2
    assert await events.get(1) == LimitEvent("2")


def test_stream_that_nobody_reads_any_more_is_forgotten() -> None:
    dispatcher = Dispatcher("a", Declarations("a"))
    kept = dispatcher.events()
    for _ in range(5):
        dispatcher.events()
    gc.collect()
    assert [*dispatcher._readers] == [kept]

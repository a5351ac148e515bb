"""Traces over HTTP: a number of messages, or as many as come in some time, or a stream."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable

import pytest

from master.graph.records import Interface
from rce.api.roles import Scopes
from rce.api.views import MessageTrace
from tests.support.master.served import Served
from tests.support.master.sse import follow

PATH = "/interfaces/brain/out/trace"


class Tracer:
    """Has `count` messages at once, and no more; `seen` are the sides that the client may see."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.seen: list[str] = []
        self.closed = asyncio.Event()

    async def follow(self, interface: str, sees: Callable[[Interface], bool]) -> AsyncIterator[MessageTrace]:
        sides = [Interface("1", "ann/brain", "out", "", ""), Interface("2", "ann/r1", "in", "", "")]
        self.seen = [side.key for side in sides if sees(side)]
        try:
            for number in range(self.count):
                yield MessageTrace(f"m{number}", interface, [])
            await asyncio.Event().wait()
        finally:
            self.closed.set()


@pytest.fixture
def tracer(populated: Served, monkeypatch: pytest.MonkeyPatch) -> Tracer:
    tracer = Tracer(3)
    monkeypatch.setattr(populated.master.tracer, "follow", tracer.follow)
    return tracer


async def test_trace_ends_after_the_number_of_messages(populated: Served, tracer: Tracer) -> None:
    answer = await populated.ask("GET", PATH + "?messages=2")
    assert [each["message"] for each in answer.body["messages"]] == ["m0", "m1"]
    await asyncio.wait_for(tracer.closed.wait(), 20)  # the endpoints are asked no more


async def test_trace_ends_after_its_time_with_what_came(populated: Served, tracer: Tracer) -> None:
    answer = await populated.ask("GET", PATH + "?messages=10&seconds=0.05")
    assert [each["message"] for each in answer.body["messages"]] == ["m0", "m1", "m2"]
    await asyncio.wait_for(tracer.closed.wait(), 20)


async def test_followed_trace_ends_after_the_number_of_messages(populated: Served, tracer: Tracer) -> None:
    follower = await follow(populated, PATH + "?follow=true&messages=2", "ann")
    assert [(await follower.next())["message"] for _ in range(2)] == ["m0", "m1"]
    assert await follower.next() is None
    await asyncio.wait_for(tracer.closed.wait(), 20)
    await follower.close()


async def test_trace_ends_when_its_follower_disconnects(populated: Served, tracer: Tracer) -> None:
    follower = await follow(populated, PATH + "?follow=true", "ann")
    await follower.next()
    await follower.close()
    await asyncio.wait_for(tracer.closed.wait(), 20)


async def test_restricted_key_traces_its_own_side(populated: Served, tracer: Tracer) -> None:
    secret, _ = await populated.master.users.keys.add("ann", scopes=Scopes(robot="r2", environments=["brain"]))
    assert (await populated.ask("GET", PATH + "?messages=1", secret=secret)).status == 200
    assert tracer.seen == ["ann/brain/out"]
    assert (await populated.ask("GET", "/interfaces/r1/in/trace", secret=secret)).status == 404


async def test_wrong_requests_are_refused(populated: Served) -> None:
    for path, user, status in (
        (PATH, "bob", 404),
        (PATH + "?user=ann", "bob", 404),
        ("/interfaces/brain/none/trace", "ann", 404),
        (PATH + "?messages=0", "ann", 400),
        (PATH + "?seconds=61", "ann", 400),
        (PATH + "?seconds=nan", "ann", 400),
    ):
        assert (await populated.ask("GET", path, user)).status == status, path

"""Messages followed through both ends of an interface, and put together."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from served import Served, serve
from twisted.internet.base import ReactorBase

from master import tracing
from master.tracing import Joined
from rce import messages as m
from rce.calls.watching import FollowMessages, Passage, Passages
from rce.errors import Lost
from rce.roles import Scopes

PATH = "/interfaces/brain/out/trace"


def test_one_id_used_again_is_another_message() -> None:
    joined = Joined()
    first, again = Passage("s", "0", "s", "entered", 1.0), Passage("s", "0", "s", "entered", 2.0)
    there = Passage("s", "0", "r", "received", 1.5)
    assert joined.add(there, 10.0) is None, "another process may be faster to tell"
    assert joined.add(first, 10.0) is None
    assert joined.add(Passage("t", "0", "t", "entered", 1.2), 10.0) is None
    assert joined.add(again, 10.5) == [there, first]
    assert joined.complete(11.1) == [[Passage("t", "0", "t", "entered", 1.2)]]
    assert joined.complete(11.6) == [[again]]


def test_messages_that_never_end_do_not_pile_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "MOST", 2)
    joined = Joined()
    for number in range(5):
        joined.add(Passage("s", str(number), "s", "entered", 1.0), 10.0)
    assert [each[0].message for each in joined.complete(10.0)] == ["0", "1", "2"]


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Served]:
    """ann's environment sends to her robot; both endpoints tell of one message."""
    monkeypatch.setattr(tracing, "PERIOD", 0.01)
    monkeypatch.setattr(tracing, "QUIET", 0.02)
    async with serve(reactor, tmp_path) as served:
        await served.robot("ann", "r1")
        for command in (
            m.CreateContainer("brain"),
            m.AddInterface("brain", "out", "SubscriberInterface", "std_msgs/String", "/out"),
            m.AddInterface("r1", "in", "PublisherConverter", "std_msgs/String"),
            m.Connect("r1/in", "brain/out"),
        ):
            await served.master.execute("ann", command)
        interfaces = served.master.state.interfaces
        out, into = interfaces["ann/brain/out"].spec.id, interfaces["ann/r1/in"].spec.id
        served.peers["ann/brain"].answers[FollowMessages] = Passages(
            [Passage(out, "m1", out, "entered", 5.0), Passage(out, "m1", out, "sent", 5.1)]
        )
        served.peers["west"].answers[FollowMessages] = Passages(
            [Passage(out, "m1", into, "received", 5.3), Passage(out, "m1", into, "delivered", 5.7)]
        )
        yield served


def told(served: Served, process: str) -> list[FollowMessages]:
    return [call for call in served.peers[process].told if isinstance(call, FollowMessages)]


async def test_what_both_endpoints_noted_is_one_message(served: Served) -> None:
    answer = await served.ask("GET", PATH + "?messages=1")
    (message,) = answer.body["messages"]
    assert (message["message"], message["source"]) == ("m1", "brain/out")
    assert [(hop["interface"], hop["hop"], hop["time"]) for hop in message["hops"]] == [
        ("brain/out", "entered", 5.0),
        ("brain/out", "sent", 5.1),
        ("r1/in", "received", 5.3),
        ("r1/in", "delivered", 5.7),
    ]
    names = {call.trace for process in ("ann/brain", "west") for call in told(served, process)}
    assert len(names) == 1
    asked = len(told(served, "west"))
    await asyncio.sleep(0.05)
    assert len(told(served, "west")) == asked, "nobody is asked after the end"


async def test_an_endpoint_that_is_away_is_missing_from_the_message(served: Served) -> None:
    served.peers["west"].refuse[FollowMessages] = Lost("it went")
    answer = await served.ask("GET", PATH + "?messages=1")
    assert [hop["hop"] for hop in answer.body["messages"][0]["hops"]] == ["entered", "sent"]


async def test_nothing_passes_within_the_time(served: Served) -> None:
    for process in ("ann/brain", "west"):
        served.peers[process].answers[FollowMessages] = Passages([])
    assert (await served.ask("GET", PATH + "?seconds=0.05")).body == {"messages": []}


async def test_others_interfaces_are_not_there(served: Served) -> None:
    assert (await served.ask("GET", PATH, user="bob")).status == 404
    assert (await served.ask("GET", PATH + "?user=ann", user="bob")).status == 404
    assert (await served.ask("GET", "/interfaces/brain/other/trace")).status == 404
    assert (await served.ask("GET", PATH + "?user=ann&messages=1", user="olga")).status == 200


async def test_a_key_that_is_tied_sees_its_own_side(served: Served) -> None:
    secret, _ = await served.master.users.keys.add("ann", scopes=Scopes(robot="r2", environments=["brain"]))
    answer = await served.ask("GET", PATH + "?messages=1", secret=secret)
    assert {hop["interface"] for hop in answer.body["messages"][0]["hops"]} == {"brain/out"}

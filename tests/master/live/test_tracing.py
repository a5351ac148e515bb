"""Tracing: hops of messages at both ends of an interface are collected."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.internet.base import ReactorBase

from master.live import tracing
from master.live.tracing import HopCollector
from rce.api.roles import Scopes
from rce.control.calls.watching import FollowMessages, Hop, HopRecord, HopRecords
from rce.errors import Lost
from rce.protocol import messages as m
from tests.support.master.served import Served, serve

PATH = "/interfaces/brain/out/trace"


def test_reused_id_is_another_message() -> None:
    joined = HopCollector()
    first, again = HopRecord("s", "0", "s", "entered", 1.0), HopRecord("s", "0", "s", "entered", 2.0)
    there = HopRecord("s", "0", "r", "received", 1.5)
    assert joined.add(there, 10.0) is None, "another process may be faster to tell"
    assert joined.add(first, 10.0) is None
    assert joined.add(HopRecord("t", "0", "t", "entered", 1.2), 10.0) is None
    assert joined.add(again, 10.5) == [there, first]
    assert joined.complete(11.1) == [[HopRecord("t", "0", "t", "entered", 1.2)]]
    assert joined.complete(11.6) == [[again]]


def test_number_of_incomplete_messages_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "MAX_INCOMPLETE", 2)
    joined = HopCollector()
    for number in range(5):
        joined.add(HopRecord("s", str(number), "s", "entered", 1.0), 10.0)
    assert [each[0].message for each in joined.complete(10.0)] == ["0", "1", "2"]


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Served]:
    """An environment of ann sends to her robot; both endpoints report the hops of one message."""
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
            await served.master.commands.execute("ann", command)
        interfaces = served.master.state.interfaces
        out, into = interfaces["ann/brain/out"].id, interfaces["ann/r1/in"].id
        served.peers["ann/brain"].answers[FollowMessages] = HopRecords(
            [HopRecord(out, "m1", out, "entered", 5.0), HopRecord(out, "m1", out, "sent", 5.1)]
        )
        served.peers["west"].answers[FollowMessages] = HopRecords(
            [HopRecord(out, "m1", into, "received", 5.3), HopRecord(out, "m1", into, "delivered", 5.7)]
        )
        yield served


def told(served: Served, process: str) -> list[FollowMessages]:
    return [call for call in served.peers[process].calls if isinstance(call, FollowMessages)]


async def test_hops_of_both_endpoints_are_joined(served: Served) -> None:
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


async def test_messages_with_one_id_are_told_apart_by_their_times(served: Served) -> None:
    interfaces = served.master.state.interfaces
    out, into = interfaces["ann/brain/out"].id, interfaces["ann/r1/in"].id

    def records(interface: str, *hops: Hop) -> HopRecords:
        return HopRecords(
            [
                HopRecord(out, "nil", interface, hop, at + 0.1 * position)
                for at in (5.0, 6.0)
                for position, hop in enumerate(hops, 2 * (interface == into))
            ]
        )

    served.peers["ann/brain"].answers[FollowMessages] = records(out, "entered", "sent")
    served.peers["west"].answers[FollowMessages] = records(into, "received", "delivered")
    (first,) = (await served.ask("GET", PATH + "?messages=1")).body["messages"]
    assert [each["time"] for each in first["hops"]] == [5.0, 5.1, 5.2, 5.3]


async def test_hops_of_an_absent_endpoint_are_missing(served: Served) -> None:
    served.peers["west"].refuse[FollowMessages] = Lost("it went")
    answer = await served.ask("GET", PATH + "?messages=1")
    assert [hop["hop"] for hop in answer.body["messages"][0]["hops"]] == ["entered", "sent"]


async def test_trace_without_messages_is_empty(served: Served) -> None:
    for process in ("ann/brain", "west"):
        served.peers[process].answers[FollowMessages] = HopRecords([])
    assert (await served.ask("GET", PATH + "?seconds=0.05")).body == {"messages": []}


async def test_interfaces_of_others_are_not_found(served: Served) -> None:
    assert (await served.ask("GET", PATH, user="bob")).status == 404
    assert (await served.ask("GET", PATH + "?user=ann", user="bob")).status == 404
    assert (await served.ask("GET", "/interfaces/brain/other/trace")).status == 404
    assert (await served.ask("GET", PATH + "?user=ann&messages=1", user="olga")).status == 200


async def test_tied_key_sees_its_own_side(served: Served) -> None:
    secret, _ = await served.master.users.keys.add("ann", scopes=Scopes(robot="r2", environments=["brain"]))
    answer = await served.ask("GET", PATH + "?messages=1", secret=secret)
    assert {hop["interface"] for hop in answer.body["messages"][0]["hops"]} == {"brain/out"}

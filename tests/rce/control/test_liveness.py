"""Liveness of control connections: who pings, and when a silent connection is closed."""

from __future__ import annotations

import asyncio

import pytest
from twisted.internet.base import ReactorBase

from rce.control import liveness
from rce.control.base_broker import BaseBroker
from rce.control.connection import Handlers
from rce.control.liveness import Liveness
from tests.support.control import TIMEOUT, closed, listening
from tests.support.hand_turned import HandTurnedLoop


class FakeBroker:
    """Broker that counts its pings and hears nothing by itself."""

    def __init__(self) -> None:
        self.heard = False
        self.pings = 0

    def ping(self) -> None:
        self.pings += 1


class Watched:
    """A connection that is checked; `ended` counts how often it was found silent."""

    def __init__(self, hand: HandTurnedLoop, pings: bool) -> None:
        self.broker = FakeBroker()
        self.ended = 0
        self.liveness = hand.do(lambda: Liveness(self.broker, pings, self._end))

    def _end(self) -> None:
        self.ended += 1


@pytest.mark.parametrize("pings", [True, False])
def test_silent_connection_is_closed_once_within_15_s(hand: HandTurnedLoop, pings: bool) -> None:
    watched = Watched(hand, pings)
    hand.turn(12)
    assert watched.ended == 0
    hand.turn(3)
    assert watched.ended == 1
    hand.turn(60)
    assert watched.ended == 1


def test_connection_stays_open_while_something_is_received_every_10_s(hand: HandTurnedLoop) -> None:
    watched = Watched(hand, False)
    for _ in range(20):
        watched.broker.heard = True
        hand.turn(10)
    assert watched.ended == 0
    watched.liveness.stop()
    hand.turn(60)
    assert watched.ended == 0


def test_only_one_side_pings(hand: HandTurnedLoop) -> None:
    active, passive = Watched(hand, True), Watched(hand, False)
    for _ in range(4):
        active.broker.heard = passive.broker.heard = True
        hand.turn(5)
    assert (active.broker.pings, passive.broker.pings) == (4, 0)


async def test_ping_is_heard_on_both_sides(reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch) -> None:
    """With frequent checks the connection would be closed at once if pings or their answers were lost."""
    monkeypatch.setattr(liveness, "CHECK_INTERVAL", 0.05)
    pongs: asyncio.Queue[None] = asyncio.Queue()
    monkeypatch.setattr(BaseBroker, "proto_pong", lambda _: pongs.put_nowait(None))
    async with listening(reactor) as listener:
        client, server = await listener.pair(Handlers())
        async with asyncio.timeout(TIMEOUT):
            for _ in range(10):
                await pongs.get()
        assert not client.lost.done()
        assert not server.lost.done()
        await closed(client, server)


async def test_peer_that_stopped_is_noticed_on_both_sides(
    reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(liveness, "CHECK_INTERVAL", 0.02)
    monkeypatch.setattr(BaseBroker, "ping", lambda _: None)
    async with listening(reactor) as listener:
        client, server = await listener.pair(Handlers())
        await asyncio.wait_for(asyncio.gather(client.lost, server.lost), TIMEOUT)

"""Terms in greetings and calls: a Master that does not lead any more is refused by those who know a later term."""

from __future__ import annotations

import asyncio

import pytest
from twisted.internet.base import ReactorBase

from rce.control.calls.call import Call, Nothing
from rce.control.client import connect
from rce.control.connection import Handlers
from rce.control.server import listen
from rce.control.term import KnownTerm, Unfenced
from rce.errors import Unavailable
from tests.support.control import HELLO, LOOPBACK, Listener, OpenJoiner


class Ping(Call[Nothing], frozen=True):
    """A call."""


class Term:
    """Fence of a Master."""

    def __init__(self, term: int) -> None:
        self.term = term

    def check(self, term: int) -> None:
        if term > self.term:
            raise Unavailable("it does not lead")


def pong() -> Handlers:
    handlers = Handlers()
    handlers.do(Ping, lambda call: None)
    return handlers


def test_known_term_only_grows() -> None:
    known = KnownTerm()
    known.check(5)
    known.check(5)
    with pytest.raises(Unavailable, match="this Master has term 4, and another one led with term 5"):
        known.check(4)
    assert known.term == 5


def test_process_without_terms_refuses_nothing() -> None:
    Unfenced().check(3)


async def test_calls_are_refused_after_a_later_term(reactor: ReactorBase) -> None:
    master, known = Term(5), KnownTerm()
    port = await listen(reactor, LOOPBACK, joiner := OpenJoiner(pong()), fence=master)
    listener = Listener(reactor, joiner, port)
    client, welcome = await connect(reactor, listener.description, HELLO, pong(), fence=known)
    server = await joiner.joined.get()
    assert welcome.term == known.term == 5
    await client.call(Ping())
    await server.call(Ping())
    known.check(6)  # it has joined another Master
    with pytest.raises(Unavailable, match="another one led with term 6"):
        await server.call(Ping())
    with pytest.raises(Unavailable, match="does not lead"):
        await client.call(Ping())
    with pytest.raises(Unavailable, match="another one led with term 6"):
        await connect(reactor, listener.description, HELLO, pong(), fence=known)
    client.close()
    await server.lost
    await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]

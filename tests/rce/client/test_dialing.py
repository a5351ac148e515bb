"""Opening a TCP connection while a network is away, slow or refuses."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from rce.client import dialing
from rce.client.dialing import address_is_gone, dial
from tests.support.hand_turned import HandTurnedLoop


@pytest.fixture
def connect(hand: HandTurnedLoop, monkeypatch: pytest.MonkeyPatch) -> list[asyncio.Future[socket.socket]]:
    """Attempts to connect, whose outcomes the test sets."""
    attempts: list[asyncio.Future[socket.socket]] = []

    async def attempt(family: int, address: Any) -> socket.socket:
        attempts.append(hand.create_future())
        return await attempts[-1]

    monkeypatch.setattr(dialing, "_connect", attempt)
    return attempts


def resolved(hand: HandTurnedLoop, monkeypatch: pytest.MonkeyPatch) -> None:
    async def getaddrinfo(host: str, port: int, **_: object) -> list[Any]:
        return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, port))]

    monkeypatch.setattr(hand, "getaddrinfo", getaddrinfo)


def begin(hand: HandTurnedLoop, work: Callable[[], Awaitable[socket.socket]]) -> asyncio.Task[socket.socket]:
    async def run() -> socket.socket:
        return await work()

    return hand.begin(run())


def test_attempts_are_repeated_until_one_succeeds(
    hand: HandTurnedLoop, connect: list[asyncio.Future[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    resolved(hand, monkeypatch)
    task = begin(hand, lambda: dial("robot", 9010, 10.0))
    for _ in range(3):
        hand.turn(dialing.INTERVAL)
    assert len(connect) == 4
    with socket.socket() as winner, socket.socket() as loser:
        connect[3].set_result(winner)
        connect[1].set_result(loser)
        hand.settle()
        assert task.result() in (winner, loser)
        assert connect[0].cancelled()
        assert [winner.fileno() == -1, loser.fileno() == -1].count(True) == 1, "the other one is closed"


def test_refusal_ends_all_attempts(
    hand: HandTurnedLoop, connect: list[asyncio.Future[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    resolved(hand, monkeypatch)
    task = begin(hand, lambda: dial("robot", 9010, 10.0))
    connect[0].set_exception(ConnectionRefusedError(errno.ECONNREFUSED, "refused"))
    hand.settle()
    assert isinstance(task.exception(), ConnectionRefusedError)


def test_attempts_continue_while_the_network_is_away(
    hand: HandTurnedLoop, connect: list[asyncio.Future[socket.socket]], monkeypatch: pytest.MonkeyPatch
) -> None:
    resolved(hand, monkeypatch)
    task = begin(hand, lambda: dial("robot", 9010, 10.0))
    connect[0].set_exception(OSError(errno.ENETUNREACH, "unreachable"))
    hand.turn(dialing.INTERVAL)
    assert not task.done()
    assert len(connect) == 2
    hand.turn(10.0)
    assert isinstance(task.exception(), TimeoutError)


def test_lost_address_is_noticed() -> None:
    class Lost:
        family = socket.AF_INET

        def getsockname(self) -> tuple[str, int]:
            return "192.0.2.1", 1234  # of a documentation network (RFC 5737)

    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        assert not address_is_gone(client)
    assert not address_is_gone(None)
    assert address_is_gone(Lost())


async def test_small_frames_are_not_delayed() -> None:
    """A message with bytes is two frames: with Nagle's algorithm the second one would wait for an acknowledgement."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        sock = await dial("127.0.0.1", server.getsockname()[1], 10.0)
        with sock:
            assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)

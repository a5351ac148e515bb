"""A robot's socket itself: its limits, what is lost on the way to it, signs of life, TLS."""

from __future__ import annotations

import asyncio
import json
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from certified import certify
from platforms import Platform, pair
from raw_robot import PASSWORD, USER, Robot, dm, eventually
from websockets.asyncio.client import connect

from endpoints.robot import server
from rce.certificates import Authority
from rce.tls import CA, CERTIFICATE, KEY, public


async def test_a_message_over_the_limit_closes_the_socket_with_the_reason(make_platform: Any) -> None:
    platform = await make_platform(message=100_000)
    a = await platform.robot("a")
    await a.send("x" * 100_001)
    code, reason = await a.closed()
    assert code == 1009
    assert "100000" in reason


async def test_too_many_bad_messages_close_the_socket_with_the_reason(make_platform: Any) -> None:
    platform = await make_platform(bad_messages=3)
    a, b = await pair(platform, features="ack,events")
    await a.send({"type": "CX", "data": {"disconnect": [{"tagA": "b/in", "tagB": "a/out"}]}})
    await a.take()
    for _ in range(5):
        await a.data("out", {"data": "to nobody"})
        assert (await a.take())["error"]["code"] == "not_connected", "which is no fault of the robot's"
    await a.send("{", "{", "{", "{")
    code, reason = await a.closed()
    assert code == 1008
    assert "3 bad messages" in reason
    await b.take()
    await b.silent()


async def test_a_robot_that_does_not_take_its_errors_is_not_listened_to(make_platform: Any) -> None:
    platform = await make_platform(bad_messages=0)
    a = await platform.robot("a")
    a.socket.transport.pause_reading()
    session = platform.endpoint.sessions[f"{USER}/a"]
    junk = "[" * 1000

    async def flood() -> None:
        while True:
            await a.send(junk)

    flooding = asyncio.create_task(flood())
    await eventually(lambda: session.outbox.backlog(b"") >= 8 and session.socket._hold is not None)
    for _ in range(50):
        await asyncio.sleep(0)
    assert session.outbox.backlog(b"") < 50
    flooding.cancel()
    a.socket.transport.abort()


async def test_of_pings_that_find_no_room_the_last_is_answered(platform: Platform) -> None:
    """A robot that does not read could have any number of answers wait for it."""
    a = await platform.robot("a")
    session = platform.endpoint.sessions[f"{USER}/a"]
    socket: Any = session.socket
    socket.pause_writing()
    answers: list[Any] = [await a.socket.ping() for _ in range(5)]
    await a.send("?")
    await eventually(lambda: session.outbox.backlog(b"") == 1)  # so they were heard
    sent: Any = await a.socket.ping()
    await eventually(lambda: socket._pinged not in (None, b""))
    assert not any(answer.done() for answer in [*answers, sent])
    socket.resume_writing()
    async with asyncio.timeout(20):
        await sent
    assert (await a.take())["type"] == "ER"


async def test_a_message_in_many_pieces_is_kept_in_few(platform: Platform) -> None:
    a, b = await pair(platform)
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    frame = json.dumps({"type": "DM", "data": dm("out", {"data": "x" * 3000})["data"]})

    async def pieces() -> AsyncIterator[str]:
        for letter in frame[:-1]:
            yield letter
            yield ""
        await eventually(lambda: b"".join(socket.message_data or ()) == frame[:-1].encode())
        assert len(socket.message_data) < 3
        yield frame[-1]

    await a.socket.send(pieces())
    assert await b.take() == dm("in", {"data": "x" * 3000})


async def test_a_robot_without_a_sign_of_life_is_given_up(make_platform: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "TICK", 0.05)
    platform = await make_platform()
    alive, dead = await platform.robot("alive"), await platform.robot("dead")
    session = platform.endpoint.sessions[f"{USER}/dead"]
    dead.socket.transport.pause_reading()
    await eventually(lambda: session.socket is None)
    await asyncio.sleep(0.2)
    await alive.silent()
    dead.socket.transport.abort()


async def test_wss(platform: Platform, tmp_path: Path) -> None:
    own = certify(tmp_path / "own", Authority.make("rce"), ["localhost"])
    secure = await server.listen(platform.endpoint, "127.0.0.1", 0, public(str(own / CERTIFICATE), str(own / KEY)))
    port = secure.sockets[0].getsockname()[1]
    trust = ssl.create_default_context(cafile=str(own / CA))
    url = f"wss://localhost:{port}/?userID={USER}&robotID=a&password={PASSWORD}"
    async with connect(url, ssl=trust, max_size=None, host="127.0.0.1", server_hostname="localhost") as socket:
        a = Robot("a", socket)
        await a.silent()
        await a.add("out", "SubscriberConverter")
        await a.add("in", "PublisherConverter")
        await a.connect("a/out", "a/in")
        await a.take_all(2)
        await a.data("out", {"data": "x" * 3_000_000})
        assert len((await a.take())["data"]["msg"]["data"]) == 3_000_000
    secure.close()

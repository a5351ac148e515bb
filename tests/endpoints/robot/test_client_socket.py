"""Robots' sockets: limits, back-pressure, liveness checks, and turns of opening requests."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from typing import Any
from unittest.mock import Mock

import pytest
from websockets.frames import Frame, Opcode

from endpoints.data import turns
from endpoints.robot import client_socket
from rce.net import pending_logins
from tests.support.endpoints.platforms import Platform, pair
from tests.support.endpoints.raw_robot import USER, dm, eventually


async def test_oversized_message_closes_socket_with_reason(make_platform: Any) -> None:
    platform = await make_platform(message=100_000)
    a = await platform.robot("a")
    await a.send("x" * 100_001)
    code, reason = await a.closed()
    assert code == 1009
    assert "100000" in reason


TEXT = b'{"type":"DM","data":{"iTag":"out","type":"std_msgs/String","msgID":"%d","msg":{"data":"x"}}}'


async def test_whole_and_fragmented_messages_keep_their_order(platform: Platform) -> None:
    a, b = await pair(platform)
    first, *rest = (TEXT % number for number in range(4))
    fragments = Frame(Opcode.TEXT, first[:20], fin=False), Frame(Opcode.CONT, first[20:])
    frames = [*fragments, *(Frame(Opcode.TEXT, each) for each in rest)]
    data = b"".join(frame.serialize(mask=True) for frame in frames)
    for part in (data[:10], data[10:-30], data[-30:]):
        a.socket.transport.write(part)
        await asyncio.sleep(0)
    assert [frame["data"]["msgID"] for frame in await b.receive_all(4)] == ["0", "1", "2", "3"]


@pytest.mark.parametrize(
    "frames",
    [
        [Frame(Opcode.TEXT, b"begin", fin=False).serialize(mask=True), Frame(Opcode.TEXT, b"{}").serialize(mask=True)],
        [Frame(Opcode.TEXT, TEXT % 1).serialize(mask=False)],
        [b"\xc1\x80mask"],
        [b"\x81\xfe\x00\x01maskx"],
    ],
    ids=["message in a message", "not masked", "not negotiated", "length not minimal"],
)
async def test_violation_of_the_protocol_closes_socket(platform: Platform, frames: list[bytes]) -> None:
    a = await platform.robot("a")
    for frame in frames:
        a.socket.transport.write(frame)
    code, _ = await a.closed()
    assert code == 1002


async def test_too_many_bad_messages_close_socket_with_reason(make_platform: Any) -> None:
    platform = await make_platform(bad_messages=3)
    a, b = await pair(platform, features="ack,events")
    await a.send({"type": "CX", "data": {"disconnect": [{"tagA": "b/in", "tagB": "a/out"}]}})
    await a.receive()
    for _ in range(5):
        await a.data("out", {"data": "to nobody"})
        assert (await a.receive())["error"]["code"] == "not_connected", "not counted as a bad message"
    await a.send("{", "{", "{", "{")
    code, reason = await a.closed()
    assert code == 1008
    assert "3 bad messages" in reason
    await b.receive()
    await b.expect_silence()


@pytest.mark.slow
async def test_reading_pauses_while_robot_does_not_take_its_errors(make_platform: Any) -> None:
    platform = await make_platform(bad_messages=0)
    a = await platform.robot("a")
    a.socket.transport.pause_reading()
    session = platform.endpoint.sessions[f"{USER}/a"]
    junk = "[" * 1000

    async def flood() -> None:
        while True:
            await a.send(junk)

    flooding = asyncio.create_task(flood())
    await eventually(lambda: session.outbox.backlog(b"") >= 8 and bool(session.socket._pauses))
    for _ in range(50):
        await asyncio.sleep(0)
    assert session.outbox.backlog(b"") < 50
    flooding.cancel()
    a.socket.transport.abort()


async def test_reading_pauses_until_all_who_asked_for_it_have_room(platform: Platform) -> None:
    await platform.robot("a")
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    first, second = (asyncio.get_running_loop().create_future() for _ in range(2))
    socket.pause_reading(first)
    socket.pause_reading(second)
    first.set_result(None)
    await asyncio.sleep(0)
    assert not socket.transport.is_reading()
    second.set_result(None)
    await asyncio.sleep(0)
    assert socket.transport.is_reading()


async def test_reading_pauses_only_if_more_comes_before_the_turn(platform: Platform) -> None:
    _, b = await pair(platform)
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    frames = [Frame(Opcode.TEXT, TEXT % number).serialize(mask=True) for number in range(3)]
    socket._turns.wait(USER, lambda: None)  # the user is busy
    socket.data_received(frames[0])
    assert socket.transport.is_reading()
    socket.data_received(frames[1])
    assert not socket.transport.is_reading()
    assert [frame["data"]["msgID"] for frame in await b.receive_all(2)] == ["0", "1"]
    assert socket.transport.is_reading()
    socket._turns.wait(USER, lambda: None)
    socket.data_received(frames[2])
    assert (await b.receive())["data"]["msgID"] == "2"


async def test_turn_does_not_end_another_pause(platform: Platform) -> None:
    _, b = await pair(platform)
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    socket._turns.wait(USER, lambda: None)
    for number in range(2):
        socket.data_received(Frame(Opcode.TEXT, TEXT % number).serialize(mask=True))
    room = asyncio.get_running_loop().create_future()
    socket.pause_reading(room)
    await eventually(lambda: not socket._turn_waits)
    await b.expect_silence()
    assert not socket.transport.is_reading()
    room.set_result(None)
    assert [frame["data"]["msgID"] for frame in await b.receive_all(2)] == ["0", "1"]
    assert socket.transport.is_reading()


async def test_end_of_another_pause_does_not_end_the_wait_for_a_turn(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, b = await pair(platform)
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    turns: list[Callable[[], None]] = []
    monkeypatch.setattr(socket, "_turns", Mock(busy=lambda _: True, wait=lambda _, work: turns.append(work)))
    room = asyncio.get_running_loop().create_future()
    socket.pause_reading(room)
    socket.data_received(Frame(Opcode.TEXT, TEXT % 1).serialize(mask=True))
    room.set_result(None)
    await b.expect_silence()
    assert socket.transport.is_reading()
    (turn,) = turns
    turn()
    assert (await b.receive())["data"]["msgID"] == "1"


async def test_open_socket_keeps_nothing_of_its_handshake(platform: Platform) -> None:
    await platform.robot("a")
    kept = vars(platform.endpoint.sessions[f"{USER}/a"].socket)
    assert not [name for name in kept if name.startswith("http_") or name in ("send_queue", "receive_queue")]


async def test_only_last_ping_is_answered_while_write_buffer_is_full(platform: Platform) -> None:
    """Else answers would pile up for a robot that does not read."""
    a = await platform.robot("a")
    session = platform.endpoint.sessions[f"{USER}/a"]
    socket: Any = session.socket
    socket.pause_writing()
    answers: list[Any] = [await a.socket.ping() for _ in range(5)]
    await a.send("?")
    await eventually(lambda: session.outbox.backlog(b"") == 1)  # so the pings before it were processed
    sent: Any = await a.socket.ping()
    await eventually(lambda: socket._pending_pong not in (None, b""))
    assert not any(answer.done() for answer in [*answers, sent])
    socket.resume_writing()
    async with asyncio.timeout(20):
        await sent
    assert (await a.receive())["type"] == "ER"


async def test_many_small_fragments_are_joined(platform: Platform) -> None:
    a, b = await pair(platform)
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    frame = json.dumps({"type": "DM", "data": dm("out", {"data": "x" * 3000})["data"]})

    async def pieces() -> AsyncIterator[str]:
        for letter in frame[:-1]:
            yield letter
            yield ""
        await eventually(lambda: b"".join(getattr(socket, "message_data", None) or ()) == frame[:-1].encode())
        assert len(socket.message_data) < 3
        yield frame[-1]

    await a.socket.send(pieces())
    assert await b.receive() == dm("in", {"data": "x" * 3000})


async def test_silent_robot_is_disconnected(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_socket, "TICK", 0.05)
    robot = await platform.robot("a")
    session = platform.endpoint.sessions[f"{USER}/a"]
    robot.socket.transport.pause_reading()
    await eventually(lambda: session.socket is None)
    robot.socket.transport.abort()


async def test_robot_that_answers_pings_stays_connected(platform: Platform) -> None:
    robot = await platform.robot("a")
    socket: Any = platform.endpoint.sessions[f"{USER}/a"].socket
    for _ in range(3):
        socket._data_received = False
        socket._check_liveness()  # sends a ping
        assert socket._silent_ticks == 1
        await eventually(lambda: socket._data_received)
        socket._check_liveness()
        assert socket._silent_ticks == 0
    await robot.expect_silence()


async def test_opening_requests_that_come_at_once_take_turns(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pending_logins, "network", lambda address: address)
    monkeypatch.setattr(turns, "SLICE", -1.0)  # each turn uses up its pass
    loop, passes, read = asyncio.get_running_loop(), [0], []

    def count() -> None:
        passes[0] += 1
        loop.call_soon(count)

    monkeypatch.setattr(client_socket.ClientSocket, "consumeData", lambda socket: read.append(passes[0]))
    writers = [(await asyncio.open_connection("127.0.0.1", platform.port))[1] for _ in range(5)]
    await eventually(lambda: len(platform.server.pending) == 5)
    count()
    for writer in writers:
        writer.write(b"GET /")
    await eventually(lambda: len(read) == 5)
    assert len(set(read)) == 5, "not two in one pass of the event loop"
    for writer in writers:
        writer.close()

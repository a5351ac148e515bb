"""Sessions after broken sockets and killed Masters: what is kept, and that it is delivered exactly once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from websockets.exceptions import InvalidStatus

from endpoints.robot.endpoint import LoginResult
from endpoints.robot.handshake import LoginRequest
from endpoints.robot.session import RobotSession
from master.execution.effect_runner import new_id
from master.graph import reconcile
from rce.control.calls.joining import Hello
from tests.support.endpoints.platforms import Platform, Processes
from tests.support.endpoints.raw_robot import (
    LOGIN_QUERY,
    USER,
    WAIT,
    WEBSOCKET_HEADERS,
    Json,
    Robot,
    dm,
    eventually,
    status,
)


async def log_in(platform: Any, tag: str, features: str = "resume", **more: Any) -> tuple[Robot, str, bool]:
    """Return the robot, its token, and whether it resumed its session."""
    robot = await platform.robot(tag, features, **more)
    first = await robot.receive()
    data = first["data"]
    assert (first["type"], data["topic"]) == ("ST", "session")
    return robot, data["token"], data.get("resumed", False)


async def connect(a: Robot, b: Robot) -> None:
    """Connect a/out to b/in."""
    await a.add("out", "SubscriberConverter")
    await a.add("in", "PublisherConverter", of="b")
    await a.connect("a/out", "b/in")
    assert await a.receive() == status("out", True)
    assert await b.receive() == status("in", True)


async def socket_lost(session: RobotSession) -> None:
    await eventually(lambda: session.socket is None)


async def test_waiting_messages_and_statuses_are_delivered_once_and_in_order(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, resumed = await log_in(platform, "b")
    assert (len(token) >= 32, resumed) == (True, False)
    await connect(a, b)
    await a.data("out", {"data": "before"})
    assert await b.receive() == dm("in", {"data": "before"})
    b.socket.transport.abort()
    await socket_lost(platform.endpoint.sessions[f"{USER}/b"])
    for number in range(5):
        await a.data("out", {"data": f"meanwhile {number}"})
    await a.add("more", "PublisherConverter", of="b")
    await a.add("some", "SubscriberConverter")
    await a.connect("b/more", "a/some")
    assert await a.receive() == status("some", True)
    b, again, resumed = await log_in(platform, "b", resume=token)
    assert resumed
    assert again != token
    frames = await b.receive_all(6)
    assert status("more", True) in frames
    frames.remove(status("more", True))
    assert frames == [dm("in", {"data": f"meanwhile {number}"}) for number in range(5)]
    await a.data("out", {"data": "after"})
    assert await b.receive() == dm("in", {"data": "after"})
    await log_in(platform, "b", resume=again)
    with pytest.raises(InvalidStatus):  # the robot has used a later one
        await platform.robot("b", "resume", resume=token)


async def test_master_knows_robots_without_socket(platform: Platform) -> None:
    """A robot in its grace time is away, also to a Master that joins the endpoint later."""
    first, token, _ = await log_in(platform, "a")
    shown, state = platform.master.presenter, platform.master.state

    def is_state(wanted: str) -> Callable[[], bool]:
        return lambda: shown.robot(state.robots[f"{USER}/a"]).state == wanted

    assert is_state("connected")()
    first.socket.transport.abort()
    await eventually(is_state("away"))
    assert platform.endpoint.report_away() == [f"{USER}/a"]
    state.away.clear()
    reconcile.joined(
        state, state.processes["robot-1"], Hello("robot", "", "", "", robots=[f"{USER}/a"], away=[f"{USER}/a"]), new_id
    )
    assert is_state("away")()
    await log_in(platform, "a", resume=token)
    await eventually(is_state("connected"))
    assert platform.endpoint.report_away() == []


async def test_second_socket_takes_over_from_open_one(platform: Platform) -> None:
    a = await platform.robot("a")
    first, token, _ = await log_in(platform, "b", "resume,parts")
    await connect(a, first)
    second, _, resumed = await log_in(platform, "b", "resume,parts", resume=token)
    assert resumed
    code, reason = await first.closed()
    assert (code, "newer connection" in reason) == (1008, True)
    await a.data("out", {"data": "hi"})
    assert await second.receive() == dm("in", {"data": "hi"})
    session = platform.endpoint.sessions[f"{USER}/b"]
    assert session.socket is not None
    assert f"{USER}/b" not in platform.endpoint._grace_timers


async def test_partly_sent_blob_is_not_continued_on_next_socket(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, _ = await log_in(platform, "b", "resume,parts")
    await a.add("out", "SubscriberForwarder")
    await a.add("in", "PublisherForwarder", of="b")
    await a.connect("a/out", "b/in")
    await a.receive()
    await b.receive()
    b.socket.transport.pause_reading()
    for name in ("0a" * 16, "0b" * 16):
        frame = {"type": "DM", "data": {"iTag": "out", "type": "std_msgs/String", "msgID": name, "msg*": name}}
        await a.send(frame, name.encode() + bytes(30_000_000))
    await a.expect_silence()
    again, _, _ = await log_in(platform, "b", "resume,parts", resume=token)
    got = await again.receive()
    assert got["data"]["msgID"] == "0b" * 16, "the first was partly sent"
    offset = 0
    while offset < 30_000_000:
        part = await again.receive()
        assert int.from_bytes(part[32:36], "big") == offset
        offset += len(part) - 40
    b.socket.transport.abort()


async def test_resumed_session_uses_new_features(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, _ = await log_in(platform, "b", "resume,ack")
    await connect(a, b)
    again = await platform.robot("b", resume=token)
    await a.data("out", {"data": "hi"})
    assert await again.receive() == dm("in", {"data": "hi"}), "no features, so no session status"
    await again.send({"type": "CN", "id": 1, "data": {}})
    await again.expect_silence()


async def test_session_ends_after_grace_time(make_platform: Any) -> None:
    platform = await make_platform(grace=0.05)
    a = await platform.robot("a")
    b, token, _ = await log_in(platform, "b")
    await connect(a, b)
    b.socket.transport.abort()
    assert await a.receive() == status("out", False)
    b, _, resumed = await log_in(platform, "b", resume=token)
    assert not resumed
    await a.expect_silence()
    assert not platform.endpoint.sessions[f"{USER}/b"].interfaces


async def test_login_takes_the_place_of_a_robot_without_a_socket(platform: Platform) -> None:
    """A program that was killed can be started again at once."""
    b = await platform.robot("b")
    await b.add("in", "PublisherConverter")
    session = platform.endpoint.sessions[f"{USER}/b"]
    b.socket.transport.abort()
    await socket_lost(session)
    await platform.robot("b")
    assert platform.endpoint.sessions[f"{USER}/b"] is not session
    assert not platform.endpoint.sessions[f"{USER}/b"].interfaces


async def test_robot_id_is_in_use_while_its_socket_is_open(platform: Platform) -> None:
    await platform.robot("b")
    with pytest.raises(InvalidStatus, match="400"):
        await platform.robot("b")


async def test_disconnect_during_login_leaves_nothing_behind(make_platform: Any) -> None:
    platform = await make_platform(grace=0.05)
    login, called, ended = platform.endpoint.login, asyncio.Event(), asyncio.Event()

    async def watched(request: LoginRequest) -> LoginResult:
        called.set()
        try:
            return await login(request)  # type: ignore[no-any-return]
        finally:
            ended.set()

    platform.endpoint.login = watched
    for _ in range(3):
        _, writer = await asyncio.open_connection("127.0.0.1", platform.port)
        writer.write(f"GET /?{LOGIN_QUERY} HTTP/1.1\r\n{WEBSOCKET_HEADERS}\r\n".encode())
        await asyncio.wait_for(called.wait(), WAIT)
        writer.transport.abort()
        await asyncio.wait_for(ended.wait(), WAIT)
        called.clear()
        ended.clear()
        await eventually(
            lambda: f"{USER}/r" not in platform.master.state.robots and f"{USER}/r" not in platform.endpoint.sessions
        )
    robot = await platform.robot("r")
    await robot.expect_silence()


def interface(tag: str, type: str = "std_msgs/String") -> Json:
    return {"endpointTag": "a", "interfaceTag": tag, "interfaceType": "PublisherConverter", "className": type}


async def connect_when_there_is_a_master(processes: Processes, name: str) -> Robot:
    """Connect as clients do, which try again when the Robot endpoint has lacked the Master for some seconds."""
    while True:
        try:
            return await processes.robot(name)
        except InvalidStatus as error:
            if error.response.status_code != 503:
                raise


@pytest.mark.slow
async def test_killed_master_loses_no_commands_and_stops_no_data(processes: Processes) -> None:
    """Commands in progress when the Master is killed are repeated at the next one; data flows meanwhile."""
    control = await processes.start_master()
    await processes.start_robot(control)
    a = await processes.robot("a", "ack")
    b = await processes.robot("b")
    await a.receive()
    await connect(a, b)
    await a.send({"type": "CN", "id": "stored", "data": {"addInterfaces": [interface("last")]}})
    await a.until(lambda frame: frame.get("id") == "stored")  # acknowledged when it is stored, as all before it
    for number in range(30):
        await a.add(f"i{number}", "PublisherConverter")
        await a.send({"type": "CN", "id": number, "data": {}})
        await a.send({"type": "CN", "id": f"j{number}", "data": {"addInterfaces": [interface(f"j{number}", "a/B")]}})
        if number == 10:
            await processes.kill("master")
    await a.data("out", {"data": "while it is away"})
    assert await b.receive() == dm("in", {"data": "while it is away"})
    late = asyncio.create_task(connect_when_there_is_a_master(processes, "late"))
    await processes.start_master(f"tcp:{control.rpartition(':')[2]}:interface=127.0.0.1")
    frames = await a.until(lambda frame: frame.get("id") == "j29")
    assert not [frame for frame in frames if frame["type"] == "ER" and "a/msg/B" not in frame["data"]], frames
    await (await asyncio.wait_for(late, WAIT)).expect_silence()
    await a.data("out", {"data": "and after"})
    assert await b.receive() == dm("in", {"data": "and after"})

"""Sockets break, robots come back, Masters die: what stays, what is delivered, and that it is delivered once."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from platforms import Platform, Processes
from raw_robot import USER, WAIT, Robot, dm, eventually, status
from test_handshake import GOOD, WS
from websockets.exceptions import InvalidStatus

from endpoints.robot.door import Admitted, Greeting
from endpoints.robot.session import Session
from master import presence
from master.rim import ids
from rce.calls.joining import Hello


async def arrive(platform: Any, tag: str, features: str = "resume", **more: Any) -> tuple[Robot, str, bool]:
    """The robot, its token, and whether it resumed."""
    robot = await platform.robot(tag, features, **more)
    first = await robot.take()
    data = first["data"]
    assert (first["type"], data["topic"]) == ("ST", "session")
    return robot, data["token"], data.get("resumed", False)


async def wire(a: Robot, b: Robot) -> None:
    """a/out to b/in."""
    await a.add("out", "SubscriberConverter")
    await a.add("in", "PublisherConverter", of="b")
    await a.connect("a/out", "b/in")
    assert await a.take() == status("out", True)
    assert await b.take() == status("in", True)


async def gone(session: Session) -> None:
    await eventually(lambda: session.socket is None)


async def test_what_waits_is_delivered_once_and_in_order_with_the_statuses(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, resumed = await arrive(platform, "b")
    assert (len(token) >= 32, resumed) == (True, False)
    await wire(a, b)
    await a.data("out", {"data": "before"})
    assert await b.take() == dm("in", {"data": "before"})
    b.socket.transport.abort()
    await gone(platform.endpoint.sessions[f"{USER}/b"])
    for number in range(5):
        await a.data("out", {"data": f"meanwhile {number}"})
    await a.add("more", "PublisherConverter", of="b")
    await a.add("some", "SubscriberConverter")
    await a.connect("b/more", "a/some")
    assert await a.take() == status("some", True)
    b, again, resumed = await arrive(platform, "b", resume=token)
    assert resumed
    assert again != token
    frames = await b.take_all(6)
    assert status("more", True) in frames
    frames.remove(status("more", True))
    assert frames == [dm("in", {"data": f"meanwhile {number}"}) for number in range(5)]
    await a.data("out", {"data": "after"})
    assert await b.take() == dm("in", {"data": "after"})
    with pytest.raises(InvalidStatus):
        await platform.robot("b", "resume", resume=token)


async def test_it_is_told_who_is_away(platform: Platform) -> None:
    """Within the grace time a robot without a socket is no connected one, also to a Master that is told of it later."""
    first, token, _ = await arrive(platform, "a")
    shown, state = platform.master.shown, platform.master.state

    def is_state(wanted: str) -> Callable[[], bool]:
        return lambda: shown.robot(state.robots[f"{USER}/a"]).state == wanted

    assert is_state("connected")()
    first.socket.transport.abort()
    await eventually(is_state("away"))
    assert platform.endpoint.away() == [f"{USER}/a"]
    state.away.clear()
    presence.joined(
        state, state.processes["robot-1"], Hello("robot", "", "", "", robots=[f"{USER}/a"], away=[f"{USER}/a"]), ids
    )
    assert is_state("away")()
    await arrive(platform, "a", resume=token)
    await eventually(is_state("connected"))
    assert platform.endpoint.away() == []


async def test_a_second_socket_takes_over_while_the_first_is_open(platform: Platform) -> None:
    a = await platform.robot("a")
    first, token, _ = await arrive(platform, "b", "resume,parts")
    await wire(a, first)
    second, _, resumed = await arrive(platform, "b", "resume,parts", resume=token)
    assert resumed
    code, reason = await first.closed()
    assert (code, "another connection" in reason) == (1008, True)
    await a.data("out", {"data": "hi"})
    assert await second.take() == dm("in", {"data": "hi"})
    session = platform.endpoint.sessions[f"{USER}/b"]
    assert session.socket is not None
    assert f"{USER}/b" not in platform.endpoint._away


async def test_a_blob_that_was_half_sent_is_not_continued_on_the_next_socket(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, _ = await arrive(platform, "b", "resume,parts")
    await a.add("out", "SubscriberForwarder")
    await a.add("in", "PublisherForwarder", of="b")
    await a.connect("a/out", "b/in")
    await a.take()
    await b.take()
    b.socket.transport.pause_reading()
    for name in ("0a" * 16, "0b" * 16):
        frame = {"type": "DM", "data": {"iTag": "out", "type": "std_msgs/String", "msgID": name, "msg*": name}}
        await a.send(frame, name.encode() + bytes(30_000_000))
    await a.silent()
    again, _, _ = await arrive(platform, "b", "resume,parts", resume=token)
    got = await again.take()
    assert got["data"]["msgID"] == "0b" * 16, "the first was on its way"
    offset = 0
    while offset < 30_000_000:
        part = await again.take()
        assert int.from_bytes(part[32:36], "big") == offset
        offset += len(part) - 40
    b.socket.transport.abort()


async def test_resuming_with_other_features_uses_those(platform: Platform) -> None:
    a = await platform.robot("a")
    b, token, _ = await arrive(platform, "b", "resume,ack")
    await wire(a, b)
    again = await platform.robot("b", resume=token)
    await a.data("out", {"data": "hi"})
    assert await again.take() == dm("in", {"data": "hi"}), "no features, so no session status"
    await again.send({"type": "CN", "id": 1, "data": {}})
    await again.silent()


async def test_after_the_grace_time_all_is_gone(make_platform: Any) -> None:
    platform = await make_platform(grace=0.05)
    a = await platform.robot("a")
    b, token, _ = await arrive(platform, "b")
    await wire(a, b)
    b.socket.transport.abort()
    assert await a.take() == status("out", False)
    b, _, resumed = await arrive(platform, "b", resume=token)
    assert not resumed
    await a.silent()
    assert not platform.endpoint.sessions[f"{USER}/b"].interfaces


async def test_within_the_grace_time_the_robot_id_is_refused(platform: Platform) -> None:
    b = await platform.robot("b")
    b.socket.transport.abort()
    await gone(platform.endpoint.sessions[f"{USER}/b"])
    with pytest.raises(InvalidStatus, match="400"):
        await platform.robot("b")
    assert f"{USER}/b" in platform.endpoint._away, "its time runs on"


async def test_a_hang_up_during_the_login_leaves_nothing(make_platform: Any) -> None:
    platform = await make_platform(grace=0.05)
    login, called, ended = platform.endpoint.login, asyncio.Event(), asyncio.Event()

    async def watched(greeting: Greeting) -> Admitted:
        called.set()
        try:
            return await login(greeting)  # type: ignore[no-any-return]
        finally:
            ended.set()

    platform.endpoint.login = watched
    for _ in range(3):
        _, writer = await asyncio.open_connection("127.0.0.1", platform.port)
        writer.write(f"GET /?{GOOD} HTTP/1.1\r\n{WS}\r\n".encode())
        await asyncio.wait_for(called.wait(), WAIT)
        writer.transport.abort()
        await asyncio.wait_for(ended.wait(), WAIT)
        called.clear()
        ended.clear()
        await eventually(
            lambda: f"{USER}/r" not in platform.master.state.robots and f"{USER}/r" not in platform.endpoint.sessions
        )
    robot = await platform.robot("r")
    await robot.silent()


async def test_killed_masters_lose_no_command_and_stop_no_data(processes: Processes) -> None:
    """Commands that are under way when the Master dies are asked of the next one; data flows on meanwhile."""
    control = await processes.start_master()
    await processes.start_robot(control)
    a = await processes.robot("a", "ack")
    b = await processes.robot("b")
    await a.take()
    await wire(a, b)
    await asyncio.sleep(0.1)  # so that the Master has saved it
    for number in range(30):
        await a.add(f"i{number}", "PublisherConverter")
        await a.send({"type": "CN", "id": number, "data": {}})
        item = {"endpointTag": "a", "interfaceTag": f"j{number}", "interfaceType": "PublisherConverter"}
        await a.send({"type": "CN", "id": f"j{number}", "data": {"addInterfaces": [item | {"className": "a/B"}]}})
        if number == 10:
            await processes.kill("master")
    await a.data("out", {"data": "while it is away"})
    assert await b.take() == dm("in", {"data": "while it is away"})
    late = asyncio.create_task(processes.robot("late"))
    await processes.start_master(f"tcp:{control.rpartition(':')[2]}:interface=127.0.0.1")
    frames = await a.until(lambda frame: frame.get("id") == "j29")
    assert not [frame for frame in frames if frame["type"] == "ER" and "a/msg/B" not in frame["data"]], frames
    await (await asyncio.wait_for(late, WAIT)).silent()
    await a.data("out", {"data": "and after"})
    assert await b.take() == dm("in", {"data": "and after"})

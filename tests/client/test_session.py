"""Handshake, commands that are repeated, refusals, events and faults of the server, seen at the fake platform."""

from __future__ import annotations

import asyncio
import logging
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from client_contract import STRING, until
from fake_platform import KEY, PASSWORD_HASH, FakePlatform, FakeWorld

from rce.client import Reconnected, Robot
from rce.errors import (
    AlreadyExists,
    InvalidName,
    InvalidRequest,
    NotFound,
    RceError,
    TimedOut,
    Unauthorized,
    Unavailable,
)
from rce.messages import DropEvent, EnvironmentEvent, LimitEvent, NodeEvent


def robot(fake: FakePlatform, timeout: float = 10) -> Robot:
    return Robot(fake.url, user="testUser", robot="a", password="testUser", timeout=timeout)


async def test_what_the_handshake_says(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        assert a.features == {"ack", "events", "resume", "parts"}
        assert a.connected
    entry, socket = fake.asked
    assert entry == "/?userID=testUser&version=20130902"
    assert parse_qs(urlsplit(socket).query) == {
        "userID": ["testUser"],
        "robotID": ["a"],
        "password": [PASSWORD_HASH],
        "features": ["ack,events,parts,resume"],
    }
    assert not a.connected


async def test_an_api_key_stands_for_the_password(fake: FakePlatform) -> None:
    async with Robot(fake.url, user="testUser", robot="a", key=KEY) as a:
        assert a.connected


async def test_a_returning_robot_shows_its_token_first_where_it_was(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        events = a.events()
        FakeWorld(fake).break_socket("a")
        await events.get(10)
        await events.get(10)
        assert len(fake.asked) == 3, "the entry was not needed"
        assert parse_qs(urlsplit(fake.asked[-1]).query)["resume"] == ["token1"]


async def test_an_endpoint_that_is_gone_is_replaced_by_the_one_that_the_entry_names(fake: FakePlatform) -> None:
    async with FakePlatform() as other, robot(fake) as a:
        said = await a.publisher("said", STRING)
        heard = await a.subscriber("heard", STRING, to="a/said")
        events = a.events()
        a._session._endpoint = "ws://127.0.0.1:9/"  # nobody listens there
        fake.port = other.port  # the entry now names the other
        fake.break_socket("a")
        await events.get(10)
        assert await events.get(10) == Reconnected(resumed=False)
        await said.publish({"data": "moved"})
        assert await heard.get(10) == {"data": "moved"}
        assert "a" in other.peers


@pytest.mark.parametrize("secret", [{"password": "wrong"}, {"key": "wrong"}])
async def test_wrong_credentials_are_unauthorized(fake: FakePlatform, secret: dict[str, Any]) -> None:
    with pytest.raises(Unauthorized, match="wrong password"):
        await Robot(fake.url, user="testUser", robot="a", **secret).open()


async def test_what_cannot_be_an_entry_is_said(fake: FakePlatform) -> None:
    with pytest.raises(InvalidRequest, match="http"):
        Robot("ws://x/", user="u", robot="a", password="p")
    with pytest.raises(InvalidRequest, match="one of the two"):
        Robot("http://x/", user="u", robot="a")
    with pytest.raises(InvalidName):
        Robot("http://x/", user="u", robot="1a", password="p")
    with pytest.raises(Unavailable, match="cannot reach"):
        await Robot("http://127.0.0.1:9/", user="u", robot="a", password="p").open()
    fake.entry_body = "<html>"
    with pytest.raises(Unavailable, match="not the entry"):
        await robot(fake).open()


async def test_a_command_whose_answer_was_lost_is_repeated_and_counts_once(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        for command in (
            lambda: a.create_environment("brain"),
            lambda: a.add_node("brain", "echo", "Test", "stringEcho.py"),
            lambda: a.set_parameter("brain", "rate", 0),
            lambda: a.publisher("said", STRING),
            lambda: a.delete_parameter("brain", "rate"),
            lambda: a.destroy_environment("brain"),
        ):
            fake.lose_next_answer()
            await command()
        frames = [frame for frame in fake.peers["a"].frames if frame["type"] == "CC"]
        assert len(frames) == 2
        assert frames[0] == frames[1]
        assert ("environment", "brain") not in fake.names


async def test_a_robot_that_is_refused_when_it_returns_ends(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        said = await a.publisher("said", STRING)
        heard = await a.subscriber("heard", STRING)
        client = await a.service_client("call", "std_srvs/SetBool")
        events = a.events()
        fake.refuse(401, "this key was revoked")
        fake.break_socket("a")
        command = asyncio.create_task(a.create_environment("brain"))
        for waiting in (heard.get(10), command, said.publish({}), client.call({}), a.create_environment("x")):
            with pytest.raises(Unauthorized, match="revoked"):
                await waiting
        with pytest.raises(Unauthorized):
            async for _ in events:
                pass


async def test_a_command_without_an_answer_times_out(fake: FakePlatform) -> None:
    async with robot(fake, timeout=0.05) as a:
        fake.deaf = True
        with pytest.raises(TimedOut, match="CreateContainer"):
            await a.create_environment("brain")


async def test_a_closed_robot_is_unavailable(fake: FakePlatform) -> None:
    a = robot(fake)
    with pytest.raises(Unavailable):
        await a.create_environment("brain")
    async with a:
        heard = await a.subscriber("heard", STRING)
    with pytest.raises(Unavailable):
        await a.create_environment("brain")
    with pytest.raises(Unavailable):
        await heard.get(10)
    await a.close()


async def test_events_arrive_as_values_and_unknown_ones_are_left_out(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        events, others = a.events(), a.events()
        await fake.event("a", topic="environment", containerTag="brain", state="lost", reason="killed")
        await fake.event("a", topic="weather", sunny=True)
        await fake.event("a", topic="node", containerTag="brain", nodeTag="n", status=-9, lines=["x"])
        await fake.event("a", topic="drops", iTag="said", count=3, where="robot")
        await fake.event("a", topic="limit", reason="too much")
        for stream in (events, others):
            assert await stream.get(10) == EnvironmentEvent("brain", "lost", "killed")
            assert await stream.get(10) == NodeEvent("brain", "n", -9, ["x"])
            assert await stream.get(10) == DropEvent("said", 3, "robot")
            assert await stream.get(10) == LimitEvent("too much")


@pytest.mark.parametrize(
    "payload",
    [
        "{",
        '{"type":"XX","data":{}}',
        '{"type":"DM","data":{}}',
        '{"type":"ST","data":{"topic":"iu"}}',
        "zz",
        b"\xff\xfe",
    ],
)
async def test_faults_of_the_server_are_events_and_end_nothing(fake: FakePlatform, payload: str | bytes) -> None:
    async with robot(fake) as a:
        events = a.events()
        await fake.send_raw("a", payload)
        assert isinstance(await events.get(10), InvalidRequest)
        await a.create_environment("brain")


async def test_an_error_that_answers_no_command_is_an_event(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        events = a.events()
        said = await a.publisher("said", STRING)
        heard = await a.subscriber("heard", STRING, to="a/said")
        fake.interfaces["a/said"] = fake.interfaces["a/said"] | {"className": "std_msgs/Int8"}
        await said.publish({"data": "x"})
        error = await events.get(10)
        assert isinstance(error, RceError)
        assert "another type" in str(error)
        assert heard.connected


async def test_an_environment_is_created_and_destroyed_and_its_topics_are_wired(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        async with a.environment("brain", size=2, group_ip="192.168.1.7", restart="no") as brain:
            await brain.add_node("echo", "Test", "stringEcho.py", args="-v")
            said = await brain.publisher("/cmd/vel", STRING)
            assert said.tag == "brain_pub_cmd_vel"
            with pytest.raises(RceError):
                await brain.publisher("/cmd/vel", STRING)
        frames = fake.peers["a"].frames
        options = {"size": 2, "groupIP": "192.168.1.7", "restart": "no"}
        assert frames[0]["data"] == {"containerTag": "brain", "containerData": options}
        assert frames[-1]["type"] == "DC"
        with pytest.raises(InvalidRequest, match="size"):
            await a.create_environment("other", size=0)
        await a.create_environment("brain")
        await a.create_environment("brain", exist_ok=True)


async def test_small_frames_overtake_the_parts_of_a_large_blob_on_the_wire(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        images = await a.publisher("images", STRING, raw=True)
        await a.subscriber("in1", STRING, to="a/images", raw=True)
        said = await a.publisher("said", STRING)
        await a.subscriber("in2", STRING, to="a/said")
        fake.kinds.clear()
        await images.publish(bytes(8 * 256 * 1024))
        await said.publish({"data": "stop"})
        await a.set_parameter("brain", "x", 1)
        await until(lambda: fake.kinds.count("part") == 8)
        assert fake.kinds.index("CN") < 5
        assert sorted(fake.kinds) == ["CN", "DM", "DM", *["part"] * 8]


async def test_offering_keeps_the_newest(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        images = await a.publisher("images", STRING, raw=True)
        heard = await a.subscriber("in", STRING, to="a/images", raw=True)
        for number in range(10):
            images.offer(bytes([number]) * 2_000_000)
        assert images.dropped == 8
        assert (await heard.get(10))[0] == 0
        assert (await heard.get(10))[0] == 9


async def test_credentials_reach_no_log(fake: FakePlatform, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        async with robot(fake) as a:
            events = a.events()
            fake.break_socket("a")
            await events.get(10)
            await events.get(10)
    assert PASSWORD_HASH not in "".join(
        record.getMessage() for record in caplog.records if not record.name.startswith("websockets.server")
    )


async def test_a_robot_is_opened_once_unless_that_failed(fake: FakePlatform) -> None:
    a = robot(fake)
    fake.refuse(503, "the Master is away")
    with pytest.raises(Unavailable, match="away"):
        await a.open()
    fake.refuse(0, "")
    async with a:
        with pytest.raises(InvalidRequest, match="make a new one"):
            await a.open()
    with pytest.raises(InvalidRequest, match="make a new one"):
        await a.open()


async def test_a_closed_interface_frees_its_tag_and_ends_its_reader(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        heard = await a.subscriber("heard", STRING)
        with pytest.raises(AlreadyExists):
            await a.subscriber("heard", STRING)
        await heard.close()
        assert [message async for message in heard] == []
        with pytest.raises(NotFound):
            await heard.close()
        said = await a.publisher("heard", STRING)
        await said.close()
        with pytest.raises(Unavailable):
            await said.publish({"data": "x"})


async def test_a_view_with_gaps_and_a_buffer_that_changes_are_sent_as_they_were(fake: FakePlatform) -> None:
    async with robot(fake) as a:
        said = await a.publisher("said", STRING, raw=True)
        heard = await a.subscriber("heard", STRING, to="a/said", raw=True)
        buffer = bytearray(b"abcdef")
        await said.publish(memoryview(buffer)[::2])
        await said.publish(buffer)
        buffer[:] = b"xxxxxx"
        assert await heard.get(10) == b"ace"
        assert await heard.get(10) == b"abcdef"

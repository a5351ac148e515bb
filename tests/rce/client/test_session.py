"""Sessions: resumption, repetition of commands, refusals and timeouts."""

from __future__ import annotations

import asyncio
import itertools
from urllib.parse import parse_qs, urlsplit

import pytest

from rce.client import Reconnected
from rce.client.session import MAX_DELAY, MIN_DELAY, backoff_delays
from rce.errors import TimedOut, Unauthorized
from tests.support.client_contract import STRING
from tests.support.fake_platform import FakePlatform


async def test_reconnecting_robot_presents_its_token_to_the_same_endpoint(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        events = a.events()
        fake.break_socket("a")
        await events.get(10)
        await events.get(10)
        assert len(fake.request_paths) == 3, "the entry was not asked again"
        assert parse_qs(urlsplit(fake.request_paths[-1]).query)["resume"] == ["token1"]


async def test_unreachable_endpoint_is_replaced_by_one_from_the_entry(fake: FakePlatform) -> None:
    async with FakePlatform() as other, fake.robot() as a:
        publisher = await a.publisher("out", STRING)
        subscriber = await a.subscriber("in", STRING, to="a/out")
        events = a.events()
        a._session._endpoint = "ws://127.0.0.1:9/"  # nothing listens there
        fake.port = other.port  # the entry now assigns the other
        fake.break_socket("a")
        await events.get(10)
        assert await events.get(10) == Reconnected(resumed=False)
        await publisher.publish({"data": "moved"})
        assert await subscriber.get(10) == {"data": "moved"}
        assert "a" in other.peers


async def test_command_with_lost_answer_is_repeated_and_succeeds(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        for command in (
            lambda: a.create_environment("brain"),
            lambda: a.add_node("brain", "echo", "Test", "stringEcho.py"),
            lambda: a.set_parameter("brain", "rate", 0),
            lambda: a.publisher("out", STRING),
            lambda: a.delete_parameter("brain", "rate"),
            lambda: a.destroy_environment("brain"),
        ):
            fake.lose_next_ack()
            await command()
        frames = [frame for frame in fake.peers["a"].frames if frame["type"] == "CC"]
        assert len(frames) == 2
        assert frames[0] == frames[1]
        assert ("environment", "brain") not in fake.resources


async def test_refusal_on_reconnection_ends_the_robot(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING)
        subscriber = await a.subscriber("in", STRING)
        client = await a.service_client("call", "std_srvs/SetBool")
        events = a.events()
        fake.refuse_robots(401, "this key was revoked")
        fake.break_socket("a")
        command = asyncio.create_task(a.create_environment("brain"))
        for pending in (subscriber.get(10), command, publisher.publish({}), client.call({}), a.create_environment("x")):
            with pytest.raises(Unauthorized, match="revoked"):
                await pending
        with pytest.raises(Unauthorized):
            async for _ in events:
                pass
        with pytest.raises(Unauthorized):
            await a.events().get(10)


async def test_command_without_answer_times_out(fake: FakePlatform) -> None:
    async with fake.robot(timeout=0.05) as a:
        fake.ignores_commands = True
        with pytest.raises(TimedOut, match="CreateContainer"):
            await a.create_environment("brain")


def test_backoff_starts_at_once_and_is_bounded() -> None:
    delays = list(itertools.islice(backoff_delays(), 20))
    assert delays[0] == 0
    assert MIN_DELAY / 2 <= delays[1] <= MIN_DELAY
    assert MAX_DELAY / 2 <= delays[-1] <= MAX_DELAY

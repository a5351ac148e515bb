"""Workers in environments, with a platform and a node that a test controls."""

from __future__ import annotations

import asyncio
from typing import Any, Self, cast

import pytest

from rce.client import Reconnected, Robot
from rce.errors import AlreadyExists, Died, NotFound, RceError, TimedOut, Unavailable
from rce.mapping.parallel.environments import EnvironmentWorker, bytes_of, cdr
from rce.mapping.parallel.units import Answer, Busy, encode
from rce.mapping.robot import NODE
from rce.protocol.messages import NodeEvent


def test_bytes_travel_as_a_ros_message() -> None:
    data = bytes(range(256))
    message = cdr(data)
    assert len(message) == 4 + 4 + 4 + 4 + 256
    assert bytes_of(message) == data


class Topic:
    """Topic that a test reads and writes."""

    def __init__(self) -> None:
        self.messages: asyncio.Queue[bytes] = asyncio.Queue()
        self.sent: asyncio.Queue[bytes] = asyncio.Queue()

    async def publish(self, data: bytes) -> None:
        self.sent.put_nowait(bytes_of(data))

    async def get(self) -> bytes:
        return await self.messages.get()


class Platform:
    """Robot and environment."""

    def __init__(self) -> None:
        self.tag = "job_0"
        self.units, self.answers = Topic(), Topic()
        self.happened: asyncio.Queue[object] = asyncio.Queue()
        self.called: list[str] = []
        self.failures: dict[str, RceError] = {}

    def environment(self, tag: str, restart: str) -> Self:
        assert (tag, restart) == (self.tag, "no")
        return self

    def events(self) -> Any:
        async def events() -> Any:
            while True:
                yield await self.happened.get()

        return events()

    def _call(self, name: str) -> None:
        self.called.append(name)
        if name in self.failures:
            raise self.failures[name]

    async def __aenter__(self) -> Self:
        self._call("create")
        return self

    async def destroy_environment(self, tag: str) -> None:
        assert tag == self.tag
        self._call("destroy")

    async def add_node(self, tag: str, pkg: str, exe: str) -> None:
        assert (tag, pkg, exe) == (NODE, "rce_mapping", "worker")
        self._call("add_node")

    async def publisher(self, topic: str, *_: object, **options: Any) -> Topic:
        assert topic == "/units"
        return self.units

    async def subscriber(self, topic: str, *_: object, **options: Any) -> Topic:
        assert topic == "/answers"
        return self.answers

    def answer(self, answer: Answer) -> None:
        self.answers.messages.put_nowait(cdr(encode(answer)))

    async def hire(self) -> EnvironmentWorker:
        self.answer(Answer(-1, Busy(0)))
        return await EnvironmentWorker.hire(cast(Robot, self), self.tag)


@pytest.fixture
def platform() -> Platform:
    return Platform()


async def test_units_go_to_the_node_and_answers_come_back(platform: Platform) -> None:
    worker = await platform.hire()
    await worker.send(b"unit")
    assert await platform.units.sent.get() == b"unit"
    platform.answer(Answer(3, Busy(7)))
    answer, size = await worker.receive()
    assert answer == Answer(3, Busy(7))
    assert size > len(encode(answer))
    await worker.close()
    assert platform.called == ["create", "add_node", "destroy"]


async def test_end_of_the_node_is_the_loss_of_the_worker(platform: Platform) -> None:
    worker = await platform.hire()
    platform.happened.put_nowait(NodeEvent(containerTag="job_0", nodeTag=NODE, status=-9, lines=["killed"]))
    with pytest.raises(Died, match="killed"):
        await worker.receive()
    platform.failures["destroy"] = NotFound("it is gone")
    await worker.close()


async def test_unit_is_sent_again_after_a_reconnect(platform: Platform) -> None:
    worker = await platform.hire()
    await worker.send(b"unit")
    platform.happened.put_nowait(Reconnected(resumed=True))
    assert [await platform.units.sent.get() for _ in range(2)] == [b"unit", b"unit"]
    await worker.close()


async def test_environment_is_destroyed_if_the_node_does_not_start(platform: Platform) -> None:
    platform.failures["add_node"] = AlreadyExists("another node")
    with pytest.raises(AlreadyExists):
        await platform.hire()
    assert platform.called == ["create", "add_node", "destroy"]


@pytest.mark.parametrize("failing", ["create", "add_node"])
async def test_environment_that_may_be_left_is_an_error_of_its_worker(platform: Platform, failing: str) -> None:
    """Its creation may have been executed although the answer did not come; its removal must be known."""
    platform.failures[failing] = TimedOut("no answer")
    with pytest.raises(TimedOut):
        await platform.hire()
    assert platform.called[-1] == "destroy"
    platform.failures = {"destroy": Unavailable("no connection")}
    worker = await platform.hire()
    with pytest.raises(Unavailable):
        await worker.close()

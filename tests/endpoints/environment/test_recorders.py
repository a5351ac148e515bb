"""Recorders of an environment without ROS, at a store in this process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from containers.recordings.receiver import RecordingReceiver
from containers.recordings.store import RecordingStore
from endpoints.data.frames import Message
from endpoints.environment import recorders as module
from endpoints.environment.interfaces import RosInterface
from endpoints.environment.recorders import Recorders
from rce.bag.reader import summarize
from rce.bag.transfer import SOCKET, Broken
from rce.control.calls.endpoints import RecorderEnded, RecorderSpec
from rce.control.calls.recordings import RecordingQuota
from rce.errors import StartFailed, UnknownType
from tests.support.endpoints.fake_ros import InstantRos


class Scripted(RosInterface):
    """Subscription whose messages the test makes up."""

    made: list[Scripted]

    async def open(self) -> None:
        self.made.append(self)
        if self.spec.addr == "/odd":
            raise UnknownType("no such type")

    def receive(self, *_: object) -> None: ...

    def arrive(self, payload: bytes) -> None:
        self.send(Message(self.id, "1", payload))


class World:
    """An environment with some topics, and the store of its machine."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.directory = directory
        self.store = RecordingStore(directory / "recordings")
        self.receiver = RecordingReceiver(self.store)
        self.receiver.ask_quota = self._ask
        self.quota = RecordingQuota()
        self.topics = {"/say": "std_msgs/msg/String", "/_hidden": "std_msgs/msg/String", "/odd": "odd/msg/Odd"}
        self.ended: asyncio.Queue[RecorderEnded] = asyncio.Queue()
        self.interfaces: list[Scripted] = []
        Scripted.made = self.interfaces
        monkeypatch.setattr(module, "SubscriberInterface", Scripted)
        monkeypatch.setattr(module, "DISCOVERY", 0.01)
        monkeypatch.setattr(module, "RETRY", 0.01)
        context = InstantRos().context()
        monkeypatch.setattr(context.definitions, "describe", lambda name, sort: {"std_msgs/msg/String": "string data"})
        socket = directory / SOCKET
        self.recorders = Recorders(context, socket, self._read_topics, self.ended.put_nowait)
        self.without = Recorders(context, None, self._read_topics, self.ended.put_nowait)

    async def _ask(self, *_: str) -> RecordingQuota:
        return self.quota

    async def _read_topics(self) -> dict[str, str]:
        return dict(self.topics)

    def open(self) -> None:
        self.receiver.add_environment("ann/brain", self.directory)

    async def interface(self, number: int = 0) -> Scripted:
        """Return a subscription once it is connected to the recorder."""
        async with asyncio.timeout(30):
            while len(self.interfaces) <= number or not self.interfaces[number].peers:  # noqa: ASYNC110  # no event
                await asyncio.sleep(0.001)
        return self.interfaces[number]

    def counts(self) -> list[dict[str, int]]:
        """Return the messages of each recording, the oldest first."""
        return [summarize(self.store.path(each.id)).counts for each in reversed(self.store.of("ann"))]


@pytest.fixture
async def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[World]:
    world = World(tmp_path, monkeypatch)
    yield world
    await world.recorders.stop_all()
    await world.receiver.close()


async def test_recorder_writes_all_topics_and_those_that_appear_later(world: World) -> None:
    world.open()
    await world.recorders.start(RecorderSpec("box"))
    (await world.interface()).arrive(b"1")
    world.topics["/late"] = "std_msgs/msg/String"
    (await world.interface(2)).arrive(b"2")  # after that of a type that is not known
    await world.recorders.stop("box")
    assert world.counts() == [{"/say": 1, "/late": 1}]
    assert [each.state for each in world.store.of("ann")] == ["complete"]
    assert {each.spec.addr for each in world.interfaces} == {"/say", "/odd", "/late"}
    assert not world.interfaces[0].peers


async def test_named_topic_is_waited_for(world: World) -> None:
    world.open()
    await world.recorders.start(RecorderSpec("box", ["/_hidden", "/late"]))
    await world.interface()
    world.topics["/late"] = "std_msgs/msg/String"
    assert (await world.interface(1)).spec.addr == "/late"


async def test_same_recorder_goes_on_and_another_replaces_it(world: World) -> None:
    world.open()
    for spec in (RecorderSpec("box"), RecorderSpec("box"), RecorderSpec("box", ["/say"])):
        await world.recorders.start(spec)
    assert world.recorders.specs == {"box": RecorderSpec("box", ["/say"])}
    assert len(world.store.of("ann")) == 2


async def test_sync_stops_and_starts_recorders(world: World) -> None:
    world.open()
    await world.recorders.start(RecorderSpec("old"))
    assert await world.recorders.sync([RecorderSpec("new")]) == {}
    assert set(world.recorders.specs) == {"new"}
    assert set(await world.without.sync([RecorderSpec("new")])) == {"recorder:new"}


async def test_lost_store_costs_the_messages_until_it_is_back(world: World) -> None:
    world.open()
    await world.recorders.start(RecorderSpec("box", ["/say"]))
    interface = await world.interface()
    interface.arrive(b"1")
    world.receiver.remove_environment("ann/brain")
    async with asyncio.timeout(30):
        while world.recorders._running["box"].writer is not None:
            interface.arrive(bytes(100_000))
            await asyncio.sleep(0.01)
    interface.arrive(b"lost")
    world.open()
    async with asyncio.timeout(30):
        while world.recorders._running["box"].writer is None:  # noqa: ASYNC110  # no event
            await asyncio.sleep(0.001)
    interface.arrive(b"2")
    await world.recorders.stop("box")
    assert [each.state for each in world.store.of("ann")] == ["complete", "cut off"]
    last = summarize(world.store.path(world.store.of("ann")[0].id))
    assert last.counts == {"/say": 1}
    assert last.dropped["/say"] >= 1


async def test_full_quota_ends_the_recorder_and_is_reported(world: World) -> None:
    world.open()
    world.quota = RecordingQuota(1000)
    await world.recorders.start(RecorderSpec("box", ["/say"]))
    interface = await world.interface()
    async with asyncio.timeout(30):
        while world.ended.empty():
            if interface.peers:
                interface.arrive(bytes(2_000_000))
            await asyncio.sleep(0.01)
    ended = world.ended.get_nowait()
    assert ended.recorder == "box"
    assert "recordings" in ended.reason
    assert world.recorders.specs == {}


async def test_environment_without_a_store_refuses(world: World) -> None:
    with pytest.raises(StartFailed, match="keeps no recordings"):
        await world.without.start(RecorderSpec("box"))


async def test_store_that_is_away_is_waited_for_only_after_a_sync(world: World) -> None:
    with pytest.raises(Broken):
        await world.recorders.start(RecorderSpec("box"))
    assert world.recorders.specs == {}
    assert await world.recorders.sync([RecorderSpec("box")]) == {}
    world.open()
    await world.interface()

"""Publishers that store their messages."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from rce.client import Store
from rce.client.stored import StoringPublisher
from rce.errors import ConversionError, InvalidRequest, LimitExceeded, NotConnected, RceError, Unavailable
from rce.protocol.messages import Delivery
from tests.support.client_contract import STRING, until
from tests.support.fake_platform import FakePlatform


async def test_unknown_choice_is_refused(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        with pytest.raises(InvalidRequest, match="offline='stor': write drop, newest, store"):
            await a.publisher("out", STRING, offline="stor")  # type: ignore[arg-type]


async def test_publish_returns_when_the_platform_has_the_message(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in", offline=Store())
        await publisher.publish({"data": "x"})
        assert await subscriber.get(10) == {"data": "x"}
        frame = next(each for each in fake.peers["a"].frames if each["type"] == "DM")
        assert frame["id"] == "out/1"
        assert frame["data"]["number"] == 1


async def test_publish_without_peer_raises_and_stores_nothing(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, offline="store")
        with pytest.raises(NotConnected):
            await publisher.publish({"data": "x"}, 0.01)
        subscriber = await a.subscriber("in", STRING, to="a/out")
        await publisher.publish({"data": "y"})
        assert await subscriber.get(10) == {"data": "y"}


async def test_messages_of_a_file_are_sent_by_the_next_program(fake: FakePlatform, tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    async with fake.robot("a") as a:
        publisher = await a.publisher("out", STRING, offline=store)
        for number in range(3):
            await publisher.publish({"data": str(number)}, wait=False)
    async with fake.robot("a") as a:
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("later", STRING, to="a/in", offline=store)
        await publisher.publish({"data": "3"})
        assert [(await subscriber.get(10))["data"] for _ in range(4)] == ["0", "1", "2", "3"]


async def test_messages_that_another_endpoint_may_have_are_dropped(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in", offline="store")
        assert isinstance(publisher, StoringPublisher)
        events = a.events()
        waits = [asyncio.create_task(publisher.publish({"data": str(number)})) for number in range(3)]
        await until(lambda: publisher._store.sent > 0)
        fake.break_socket("a")
        fake.incarnation = "second"
        await publisher.publish({"data": "after"}, wait=False)
        await events.get(10)
        await publisher.publish({"data": "last"})
        outcomes = await asyncio.gather(*waits, return_exceptions=True)
        lost = [each for each in outcomes if isinstance(each, LimitExceeded)]
        assert lost
        assert publisher.dropped == len(lost)
        received = []
        while "last" not in received:
            received.append((await subscriber.get(10))["data"])
        assert len(received) == len(set(received)), "none arrives twice"
        assert received[-2:] == ["after", "last"]


async def test_refused_message_is_reported_and_not_sent_again(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in", offline="store")
        events = a.events()
        fake.refuse_message("wrong field")
        with pytest.raises(ConversionError, match="wrong field"):
            await publisher.publish({"data": "x"})
        assert isinstance(await events.get(10), ConversionError)
        await publisher.publish({"data": "y"})
        assert await subscriber.get(10) == {"data": "y"}


async def test_message_whose_peer_has_just_gone_is_sent_when_it_is_back(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        subscriber = await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in", offline="store")
        pair = next(iter(fake.connections))
        fake.connections.clear()  # the status of the interface has not arrived yet
        sent = asyncio.create_task(publisher.publish({"data": "x"}))
        await until(lambda: "DM" in fake.frame_types)
        fake.connections.add(pair)
        await sent
        assert await subscriber.get(10) == {"data": "x"}


async def test_old_and_surplus_messages_are_dropped_and_counted(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        old = await a.publisher("old", STRING, offline="store", delivery=Delivery(maxAge=1e-9))
        full = await a.publisher("full", STRING, offline=Store(max_bytes=1000))
        for number in range(4):
            await old.publish({"data": str(number)}, wait=False)
            await full.publish({"data": str(number) * 400}, wait=False)
        assert full.dropped == 3
        subscriber = await a.subscriber("in", STRING, to="a/full")
        assert (await subscriber.get(10))["data"][0] == "3"
        await a.connect("a/old", "a/in")
        await until(lambda: old.dropped == 4)


async def test_close_ends_those_who_wait_and_frees_the_file(fake: FakePlatform, tmp_path: Path) -> None:
    async with fake.robot("a") as a:
        await a.subscriber("in", STRING)
        publisher = await a.publisher("out", STRING, to="a/in", offline=Store(tmp_path / "store"))
        fake.connections.clear()
        waits = asyncio.create_task(publisher.publish({"data": "x"}))
        await until(lambda: "DM" in fake.frame_types)
        await publisher.close()
        with pytest.raises(Unavailable):
            await waits
        with pytest.raises(RceError):
            await publisher.publish({"data": "y"}, wait=False)
        again = await a.publisher("out", STRING, offline=Store(tmp_path / "store"))
        await again.close()


async def test_offer_stores(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        publisher = await a.publisher("out", STRING, offline="store")
        assert all(publisher.offer({"data": str(number)}) for number in range(3))
        subscriber = await a.subscriber("in", STRING, to="a/out")
        assert [(await subscriber.get(10))["data"] for _ in range(3)] == ["0", "1", "2"]
        await publisher.close()
        assert not publisher.offer({"data": "late"})


async def test_message_in_the_queue_of_a_closed_publisher_is_not_sent(fake: FakePlatform) -> None:
    async with fake.robot("a") as a:
        subscriber = await a.subscriber("in", STRING)
        large = await a.publisher("large", STRING, raw=True)
        await a.connect("a/large", "a/in")
        publisher = await a.publisher("out", STRING, to="a/in", offline="store")
        large.offer(bytes(3_000_000), keep=9)  # so that the next message waits in the queue of the socket
        await publisher.publish({"data": "x"}, wait=False)
        await publisher.close()
        assert len(await subscriber.get(10)) == 3_000_000
        await large.publish(b"the connection stands")
        assert await subscriber.get(10) == b"the connection stands"


async def test_full_disk_does_not_stop_what_is_stored_already(fake: FakePlatform, tmp_path: Path) -> None:
    async with fake.robot("a") as a:
        publisher = await a.publisher("out", STRING, offline=Store(tmp_path / "store"))
        assert isinstance(publisher, StoringPublisher)
        await publisher.publish({"data": "x"}, wait=False)
        publisher._store._db.execute("PRAGMA query_only = ON")  # every change fails from now on
        subscriber = await a.subscriber("in", STRING, to="a/out")
        assert await subscriber.get(10) == {"data": "x"}
        with pytest.raises(RceError):
            await publisher.publish({"data": "y"}, wait=False)

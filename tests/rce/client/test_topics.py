"""Publishers and subscribers."""

from __future__ import annotations

import asyncio
import time

import pytest

from rce.errors import AlreadyExists, NotFound, Unavailable
from rce.protocol.messages import Delivery
from tests.support.client_contract import STRING
from tests.support.fake_platform import FakePlatform


async def test_offer_keeps_the_newest(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        images = await a.publisher("images", STRING, raw=True)
        subscriber = await a.subscriber("in", STRING, to="a/images", raw=True)
        for number in range(10):
            images.offer(bytes([number]) * 2_000_000)
        assert images.dropped == 8
        assert (await subscriber.get(10))[0] == 0
        assert (await subscriber.get(10))[0] == 9


async def test_closed_interface_frees_its_tag_and_ends_its_readers(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        subscriber = await a.subscriber("in", STRING)
        with pytest.raises(AlreadyExists):
            await a.subscriber("in", STRING)
        await subscriber.close()
        assert [message async for message in subscriber] == []
        with pytest.raises(NotFound):
            await subscriber.close()
        publisher = await a.publisher("in", STRING)
        await publisher.close()
        assert not publisher.connected
        assert not publisher.offer({"data": "x"})
        with pytest.raises(Unavailable):
            await publisher.publish({"data": "x"})


async def test_non_contiguous_view_and_reused_buffer_are_sent_as_they_were(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, raw=True)
        subscriber = await a.subscriber("in", STRING, to="a/out", raw=True)
        buffer = bytearray(b"abcdef")
        await publisher.publish(memoryview(buffer)[::2])
        await publisher.publish(buffer)
        buffer[:] = b"xxxxxx"
        assert await subscriber.get(10) == b"ace"
        assert await subscriber.get(10) == b"abcdef"


async def test_message_that_is_too_old_when_its_turn_comes_is_dropped(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, delivery=Delivery(maxAge=1e-9))
        subscriber = await a.subscriber("in", STRING, to="a/out")
        assert publisher.offer({"data": "late"})
        await publisher.publish({"data": "late"})
        await publisher.publish({"data": "late"}, wait=False)
        other = await a.publisher("other", STRING)
        await a.connect("a/other", "a/in")
        await other.publish({"data": "in time"})
        assert await subscriber.get(10) == {"data": "in time"}
        assert publisher.dropped == 3


async def test_messages_beyond_the_rate_give_way(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, delivery=Delivery(rate=0.001))
        subscriber = await a.subscriber("in", STRING, to="a/out")
        assert publisher.offer({"data": "first"})
        assert not publisher.offer({"data": "second"})
        for _ in range(2):
            await publisher.publish({"data": "third"}, wait=False)
        assert await subscriber.get(10) == {"data": "first"}
        assert publisher.dropped == 2, "the last one waits"


async def test_publisher_that_waits_is_slowed_to_the_rate(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, delivery=Delivery(rate=100))
        subscriber = await a.subscriber("in", STRING, to="a/out")
        began = time.monotonic()
        for number in range(4):
            await publisher.publish({"data": str(number)})
        assert time.monotonic() - began >= 0.03
        assert [(await subscriber.get(10))["data"] for _ in range(4)] == ["0", "1", "2", "3"]


async def test_message_of_high_priority_overtakes_the_parts_of_others(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        image = await a.publisher("image", STRING, raw=True, delivery=Delivery("low"))
        speed = await a.publisher("speed", STRING, delivery=Delivery("high"))
        order: list[str] = []
        seen = asyncio.Event()

        def note(name: str) -> None:
            order.append(name)
            if len(order) == 6:
                seen.set()

        await a.subscriber("images", STRING, to="a/image", raw=True, callback=lambda _: note("image"))
        await a.subscriber("speeds", STRING, to="a/speed", callback=lambda _: note("speed"))
        image.offer(bytes(2_000_000), keep=9)
        for _ in range(5):
            speed.offer({"data": "x"}, keep=9)
        await asyncio.wait_for(seen.wait(), 10)
        assert order == [*["speed"] * 5, "image"]


async def test_offer_keeps_the_newest_while_offline_if_the_publisher_does(fake: FakePlatform) -> None:
    async with fake.robot() as a:
        publisher = await a.publisher("out", STRING, offline="newest")
        assert publisher.offer({"data": "old"})
        assert publisher.offer({"data": "new"})
        subscriber = await a.subscriber("in", STRING, to="a/out")
        assert await subscriber.get(10) == {"data": "new"}
        assert publisher.dropped == 1

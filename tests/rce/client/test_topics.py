"""Publishers and subscribers."""

from __future__ import annotations

import pytest

from rce.errors import AlreadyExists, NotFound, Unavailable
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

"""Reading of texts in a worker."""

from __future__ import annotations

import asyncio

import pytest

from rce.errors import InvalidRequest
from rce.knowledge.messages import Document, Read, Reading, Readings, Reply
from rce.knowledge.texts import Texts
from rce.knowledge.worker import Worker


class FakeWorker(Worker):
    async def ask(self, work: object) -> Reply:
        assert isinstance(work, Read)
        refused = InvalidRequest("no", field="owl").info
        return Readings([Reading(refused=refused if each.text == "bad" else None, count=1) for each in work.documents])


async def test_empty_text_needs_no_worker_and_a_bad_one_is_an_error() -> None:
    texts = Texts(FakeWorker)
    assert await texts.read("ann", "http://a", " ") == Reading()
    assert (await texts.read("ann", "http://a", "good")).count == 1
    with pytest.raises(InvalidRequest, match="no"):
        await texts.read("ann", "http://a", "bad")
    results = await texts.read_all("ann", [Document("a", "bad"), Document("a", "good")])
    assert [each.refused is None for each in results] == [False, True]
    await texts.stop()


async def test_users_take_turns() -> None:
    """The second user waits for one request of the first, however many are waiting."""
    gate, order = asyncio.Event(), list[str]()

    class Slow(FakeWorker):
        async def ask(self, work: object) -> Reply:
            await gate.wait()
            assert isinstance(work, Read)
            order.append(work.documents[0].text)
            return await super().ask(work)

    texts = Texts(Slow)
    asked = [asyncio.create_task(texts.read("ann", "http://a", f"ann {number}")) for number in range(3)]
    await asyncio.sleep(0)
    asked.append(asyncio.create_task(texts.read("bob", "http://b", "bob")))
    await asyncio.sleep(0)
    gate.set()
    await asyncio.gather(*asked)
    assert order == ["ann 0", "bob", "ann 1", "ann 2"]
    assert not texts._turns

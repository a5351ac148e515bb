"""Mirror of a collection, fed by an API in memory."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")

from containers.kubernetes import mirror as module
from containers.kubernetes.api import GONE, Event, Refused
from containers.kubernetes.mirror import Mirror
from containers.kubernetes.objects import Object
from rce.errors import Unavailable
from tests.support.kubernetes.fake_api import FakeApi, thing

PATH = "/api/v1/pods"


def read(found: Object) -> tuple[str, int]:
    return found["metadata"]["uid"], int(found["metadata"]["resourceVersion"])


class Followed:
    """A mirror and what it has reported."""

    def __init__(self) -> None:
        self.api = FakeApi({PATH: [thing("a"), thing("b")]})
        self.reports: list[str] = []
        self.mirror = Mirror(
            self.api,
            PATH,
            "",
            read,
            self._changed,
            lambda each: self.reports.append(f"{each[0]} gone"),
        )

    def _changed(self, found: tuple[str, int]) -> None:
        self.reports.append(f"{found[0]} {found[1]}")
        if found[0] == "defect":
            raise TypeError("a defect")

    async def until(self, report: str) -> None:
        with self.mirror.changes() as change:
            async with asyncio.timeout(10):
                while report not in self.reports:
                    change.clear()
                    await change.wait()


@pytest.fixture
async def followed(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Followed]:
    monkeypatch.setattr(module, "RETRY_DELAY", 0.0)
    followed = Followed()
    await followed.mirror.open()
    yield followed
    await followed.mirror.close()


async def test_objects_are_listed_and_then_watched(followed: Followed) -> None:
    assert followed.reports == ["a 1", "b 1"]
    for event in (
        Event("MODIFIED", thing("a", 2)),
        Event("BOOKMARK", thing("", 3)),
        Event("DELETED", thing("b", 4)),
        Event("ADDED", thing("c", 5)),
    ):
        followed.api.events.put_nowait(event)
    await followed.until("c 5")
    assert followed.reports[2:] == ["a 2", "b gone", "c 5"]
    assert set(followed.mirror.objects) == {"a", "c"}


async def test_lost_watch_is_taken_up_again_without_a_list(followed: Followed) -> None:
    followed.api.events.put_nowait(Unavailable("Kubernetes does not answer"))
    followed.api.events.put_nowait(Event("MODIFIED", thing("a", 2)))
    await followed.until("a 2")
    assert followed.api.listed == 1


async def test_expired_watch_finds_all_differences_by_a_list(followed: Followed) -> None:
    followed.api.lists[PATH] = [thing("a"), thing("c", 7)]
    followed.api.events.put_nowait(Refused("too old resource version", GONE))
    await followed.until("c 7")
    assert followed.reports[2:] == ["b gone", "c 7"]


async def test_error_of_the_first_list_is_raised() -> None:
    api = FakeApi()
    with pytest.raises(Exception, match="not found"):
        await Mirror(api, PATH, "", read, lambda each: None, lambda each: None).open()


async def test_object_that_cannot_be_read_is_passed_over(followed: Followed) -> None:
    bad = thing("a")
    bad["metadata"]["resourceVersion"] = "?"
    for event in (Event("MODIFIED", bad), Event("DELETED", thing("?", 3)), Event("ADDED", thing("c", 5))):
        followed.api.events.put_nowait(event)
    await followed.until("c 5")
    assert followed.mirror.objects["a"] == ("a", 1), "as it was last"
    followed.api.events.put_nowait(Event("DELETED", bad))
    await followed.until("a gone")


async def test_defect_ends_neither_the_watch_nor_what_follows(followed: Followed) -> None:
    followed.api.events.put_nowait(Event("ADDED", thing("defect")))
    followed.api.events.put_nowait(Event("MODIFIED", thing("a", 10)))
    await followed.until("a 10")
    assert followed.api.listed == 1


async def test_event_without_an_object_leads_to_a_list_even_if_that_fails_at_first(followed: Followed) -> None:
    items = followed.api.lists.pop(PATH)
    followed.api.events.put_nowait(Event("ADDED", {}))
    await asyncio.sleep(0.05)  # in which the list fails several times
    followed.api.lists[PATH] = [*items, thing("d", 9)]
    await followed.until("d 9")

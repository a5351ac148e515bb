"""The client of recordings at a Master whose machine keeps them."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TypeVar

import pytest
from twisted.internet.base import ReactorBase

from containers.recordings.store import MAGIC, RecordingStore
from rce.client import Robot
from rce.client.recordings import RecordingsClient
from rce.client.tus import FIRST_CHUNK
from rce.errors import NotFound
from tests.support.master.recordings import keep_recordings, recorded
from tests.support.master.served import PASSWORD, Served, serve

CONTENT = MAGIC + random.Random(1).randbytes(1_000_000) + MAGIC
T = TypeVar("T")


@pytest.fixture
async def served(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Served]:
    async with serve(reactor, tmp_path) as served:
        yield served


@pytest.fixture
def store(served: Served, tmp_path: Path) -> RecordingStore:
    return keep_recordings(served, "m1", tmp_path / "m1")


async def do(served: Served, work: Callable[[RecordingsClient], T], user: str = "ann") -> T:
    client = RecordingsClient(served.url, user=user, password=PASSWORD)
    return await asyncio.to_thread(work, client)


async def test_recordings_are_listed_fetched_and_removed(served: Served, store: RecordingStore, tmp_path: Path) -> None:
    name = f"m1/{recorded(store, CONTENT)}"
    recorded(store, MAGIC, "ann/attic")
    assert len((await do(served, lambda client: client.pages())).items) == 2
    (found,) = (await do(served, lambda client: client.pages("", "brain"))).items
    assert f"{found.machine}/{found.recording}" == name
    (tmp_path / f".a.mcap.{found.recording}.part").write_bytes(CONTENT[:1000])  # of an interrupted download
    seen: list[int] = []
    await do(served, lambda client: client.fetch(name, tmp_path / "a.mcap", progress=seen.append))
    assert (tmp_path / "a.mcap").read_bytes() == CONTENT
    assert seen[-1] == len(CONTENT)
    of_ann = await do(served, lambda client: client.get(name, "ann"), "olga")
    assert of_ann.size == len(CONTENT)
    await do(served, lambda client: client.remove(name))
    with pytest.raises(NotFound):
        await do(served, lambda client: client.fetch(name, tmp_path / "b.mcap"))


async def test_robot_uploads_its_recording_once(served: Served, store: RecordingStore, tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    path.write_bytes(CONTENT)
    robot = Robot(served.url, user="ann", robot="r1", password=PASSWORD)
    name = await robot.upload_recording(path)
    assert await robot.upload_recording(path) == name
    (found,) = store.of("ann")
    assert (f"m1/{found.id}", found.state, found.name) == (name, "complete", "own.mcap")
    assert store.path(found.id).read_bytes() == CONTENT


async def test_interrupted_upload_goes_on(served: Served, store: RecordingStore, tmp_path: Path) -> None:
    path = tmp_path / "own.mcap"
    path.write_bytes(CONTENT)

    class Broken(Exception): ...

    def stop(sent: int) -> None:
        if sent > FIRST_CHUNK:
            raise Broken

    with pytest.raises(Broken):
        await do(served, lambda client: client.upload(path, stop))
    (found,) = store.of("ann")
    assert found.size >= FIRST_CHUNK
    name = f"m1/{found.id}"
    assert (await do(served, lambda client: client.upload(path))).id == name
    assert store.of("ann")[0].state == "complete"

"""Inspection of recordings before a job is accepted."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from twisted.internet.task import Clock

from rce.api.map_jobs import MapOptions
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.mapservice.inspection import MAX_INSPECTIONS, MAX_INSPECTIONS_OF_USER, InspectionQueue, collect
from rce.mapservice.job_program import Task
from rce.mapservice.uploads import Uploads
from tests.support.map_service import LIMITS

TASK = Task("recording", MapOptions())


class GatedInspector:
    """Inspector whose inspections run until the test ends them."""

    def __init__(self) -> None:
        self.running: list[asyncio.Future[int | None]] = []
        self.began = asyncio.Event()

    async def inspect(self, task: Task) -> int | None:
        self.began.set()
        self.running.append(asyncio.get_running_loop().create_future())
        return await self.running[-1]


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def uploads(tmp_path: Path, clock: Clock) -> Uploads:
    return Uploads(tmp_path / "uploads", LIMITS.uploads, lambda _: 0, clock.seconds)


def uploaded(uploads: Uploads, name: str, user: str = "ann", missing: int = 0) -> str:
    upload = uploads.create(user, name, 4 + missing)
    uploads.path(upload.id).write_bytes(b"abcd")
    return upload.id


def test_single_file_is_the_recording(uploads: Uploads, tmp_path: Path) -> None:
    upload = uploaded(uploads, "a.log")
    recording = collect(uploads, "ann", [upload], tmp_path / "job")
    assert recording == tmp_path / "job" / "a.log"
    assert recording.samefile(uploads.path(upload)), "it is not copied"


def test_directory_of_several_files_is_the_recording(uploads: Uploads, tmp_path: Path) -> None:
    names = [uploaded(uploads, name) for name in ("a.mcap", "metadata.yaml")]
    recording = collect(uploads, "ann", names, tmp_path / "job")
    assert recording == tmp_path / "job"
    assert sorted(path.name for path in recording.iterdir()) == ["a.mcap", "metadata.yaml"]


def test_use_of_an_upload_prolongs_its_life(uploads: Uploads, clock: Clock, tmp_path: Path) -> None:
    upload = uploaded(uploads, "a.log")
    before = uploads.get("ann", upload).expires
    clock.advance(5)
    collect(uploads, "ann", [upload], tmp_path / "job")
    assert uploads.get("ann", upload).expires == before + 5


def test_wrong_upload_is_named_by_its_place(uploads: Uploads, tmp_path: Path) -> None:
    whole = uploaded(uploads, "a.log")
    wrong: list[tuple[str, type[Exception], str]] = [
        ("0" * 24, NotFound, "no upload"),
        (uploaded(uploads, "c.log", "bob"), NotFound, "no upload"),
        (uploaded(uploads, "b.log", missing=5), InvalidRequest, "4 of 9 bytes"),
        (uploaded(uploads, "a.log"), InvalidRequest, "two files a.log"),
    ]
    for number, (upload, kind, reason) in enumerate(wrong):
        with pytest.raises(kind, match=reason) as refused:
            collect(uploads, "ann", [whole, upload], tmp_path / str(number))
        assert getattr(refused.value, "field", "") == "uploads[1]"


async def begin(queue: InspectionQueue, user: str) -> asyncio.Task[int | None]:
    """Start an inspection and let it run until it waits."""
    task = asyncio.create_task(queue.inspect(user, TASK))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return task


async def test_number_of_scans_is_returned() -> None:
    inspector = GatedInspector()
    queue = InspectionQueue(inspector)
    task = await begin(queue, "ann")
    assert queue.count("ann") == 1
    inspector.running[0].set_result(12)
    assert await task == 12
    assert queue.count("ann") == 0


async def test_inspections_of_a_user_are_limited() -> None:
    inspector = GatedInspector()
    queue = InspectionQueue(inspector)
    tasks = [await begin(queue, "ann") for _ in range(MAX_INSPECTIONS_OF_USER)]
    with pytest.raises(LimitExceeded, match="being inspected"):
        await queue.inspect("ann", TASK)
    assert queue.count("ann") == MAX_INSPECTIONS_OF_USER
    inspector.running[0].set_exception(InvalidRequest("no scans"))
    with pytest.raises(InvalidRequest, match="no scans"):
        await tasks[0]
    tasks.append(await begin(queue, "ann"))  # a refused recording frees its place
    for task in tasks[1:]:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    assert queue.count("ann") == 0


async def test_inspections_of_all_users_are_limited() -> None:
    inspector = GatedInspector()
    queue = InspectionQueue(inspector)
    tasks = [await begin(queue, f"user{number}") for number in range(MAX_INSPECTIONS + 1)]
    assert len(inspector.running) == MAX_INSPECTIONS
    assert queue.count(f"user{MAX_INSPECTIONS}") == 1, "the last one waits"
    inspector.began.clear()
    inspector.running[0].set_result(1)
    await tasks[0]
    await inspector.began.wait()
    for running in inspector.running[1:]:
        running.set_result(None)
    assert await asyncio.gather(*tasks[1:]) == [None] * MAX_INSPECTIONS

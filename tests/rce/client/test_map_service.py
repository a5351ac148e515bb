"""The client of the map service, with a service in this process and connections that break."""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from rce.api.map_jobs import MAPPERS, Job, MapOptions
from rce.client.map_service import MapServiceClient
from rce.client.tus import fingerprint
from rce.errors import InvalidRequest, NotFound, Unauthorized, Unavailable
from rce.mapping import mappers
from rce.mapservice.job_program import Report
from tests.support.map_service import LOG, Service

CONTENT = b"\x89MCAP0\r\n" + random.Random(1).randbytes(3_000_000)


class BreakingProxy:
    """TCP proxy that aborts connections after the numbers of bytes in `breaks`, one for each connection.

    `forwarded` counts the bytes of all connections towards the service.
    """

    def __init__(self, url: str) -> None:
        self._target = url.split("/")[2].split(":")
        self.breaks: list[int] = []
        self.forwarded = 0
        self.url = ""

    async def start(self) -> None:
        self._server = await asyncio.start_server(self._forward, "127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}/"

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        service_reader, service_writer = await asyncio.open_connection(*self._target)
        left = self.breaks[0] if self.breaks else None

        async def forward_responses() -> None:
            while data := await service_reader.read(65536):
                writer.write(data)
            writer.close()

        responses = asyncio.create_task(forward_responses())
        try:
            while data := await reader.read(65536):
                self.forwarded += len(data)
                if left is not None and (left := left - len(data)) < 0:
                    self.breaks.pop(0)
                    writer.transport.abort()
                    break
                service_writer.write(data)
                await service_writer.drain()
        except ConnectionError:
            pass
        finally:
            service_writer.close()
            await asyncio.wait({responses})

    def stop(self) -> None:
        self._server.close()


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    async with Service(tmp_path / "maps") as service:
        yield service


@pytest.fixture
async def proxy(service: Service) -> AsyncIterator[BreakingProxy]:
    proxy = BreakingProxy(service.url)
    await proxy.start()
    yield proxy
    proxy.stop()


def client(url: str, key: str = "rce_ann", patience: float = 20.0) -> MapServiceClient:
    return MapServiceClient(url, key=key, patience=patience)


async def in_thread(function: Any, *arguments: Any) -> Any:
    return await asyncio.to_thread(function, *arguments)


async def test_interrupted_upload_is_resumed(service: Service, proxy: BreakingProxy, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(CONTENT)
    proxy.breaks = [700_000, 900_000]
    progress: list[int] = []
    upload = await in_thread(client(proxy.url).upload, path, progress.append)
    assert upload.offset == len(CONTENT)
    assert service.service.uploads.path(upload.id).read_bytes() == CONTENT
    assert proxy.breaks == [], "both connections were broken"
    assert proxy.forwarded < 2 * len(CONTENT), "received bytes are not sent again"
    assert progress[-1] == len(CONTENT)


async def test_later_run_resumes_the_upload_of_an_earlier_one(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(CONTENT)
    partial = service.service.uploads.create("ann", path.name, len(CONTENT), fingerprint(path)).id
    service.service.uploads.path(partial).write_bytes(CONTENT[:1_000_000])
    progress: list[int] = []
    upload = await in_thread(client(service.url).upload, path, progress.append)
    assert (upload.id, progress[0]) == (partial, 1_000_000)
    assert service.service.uploads.path(partial).read_bytes() == CONTENT
    assert (await in_thread(client(service.url).upload, path)).id == partial, "a complete upload is not sent again"
    path.write_bytes(CONTENT[:-1] + b"x")
    assert (await in_thread(client(service.url).upload, path)).id != partial


async def test_uploads_are_listed_until_they_are_removed(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(CONTENT)
    maps = client(service.url)
    upload = await in_thread(maps.upload, path)
    assert await in_thread(maps.uploads) == [upload]
    await in_thread(maps.remove_upload, upload.id)
    assert await in_thread(maps.uploads) == []
    with pytest.raises(NotFound):
        await in_thread(maps.remove_upload, upload.id)


async def test_file_that_is_no_recording_is_rejected_early(
    service: Service, proxy: BreakingProxy, tmp_path: Path
) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(bytes(5_000_000))
    with pytest.raises(InvalidRequest, match="not a ROS 1 bag"):
        await in_thread(client(proxy.url).upload, path)
    assert proxy.forwarded < 200_000


async def test_job_is_watched_and_its_files_are_fetched(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(LOG)
    maps = client(service.url)
    upload = await in_thread(maps.upload, path)
    job = await in_thread(maps.submit, [upload.id], MapOptions(mapper="particle", resolution=0.1), "corridor")
    assert (job.recording, job.options.mapper) == ("corridor", "particle")

    loop = asyncio.get_running_loop()
    updates: asyncio.Queue[Job] = asyncio.Queue()

    def watch() -> None:
        for update in maps.watch(job.id):
            loop.call_soon_threadsafe(updates.put_nowait, update)

    watching = asyncio.create_task(in_thread(watch))
    async with asyncio.timeout(60):
        service.runner.report(job.id, Report("mapping", 3))
        while (await updates.get()).scans != 3:
            pass
        service.runner.finish(job.id)
        while (await updates.get()).state != "done":
            pass
        await watching

    await in_thread(maps.fetch, job.id, "map.png", tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes() == b"a picture"
    with pytest.raises(NotFound):
        await in_thread(maps.fetch, job.id, "map.pgm", tmp_path / "map.pgm")
    assert sorted(os.listdir(tmp_path)) == ["a.log", "map.png", "maps"]
    assert [each.id for each in await in_thread(maps.jobs)] == [job.id]
    await in_thread(maps.remove, job.id)
    with pytest.raises(NotFound):
        await in_thread(maps.job, job.id)


async def test_errors_of_access(service: Service) -> None:
    with pytest.raises(Unauthorized):
        await in_thread(client(service.url, key="rce_nobody").jobs)
    with pytest.raises(Unavailable, match="cannot reach"):
        await in_thread(client("http://127.0.0.1:1/", patience=0.1).jobs)
    with pytest.raises(InvalidRequest, match="http://"):
        client("no url")
    with pytest.raises(InvalidRequest, match="either a password or an API key"):
        MapServiceClient(service.url, user="ann")


def test_mappers_of_the_api_are_those_of_the_mapping_node() -> None:
    assert set(MAPPERS) == set(mappers.MAPPERS)

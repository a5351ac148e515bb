"""The client of the map service, with a service in this process and connections that break."""

from __future__ import annotations

import argparse
import asyncio
import os
import random
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from maps_in_memory import LOG, Service

from rce.client.map_service import MapService, fingerprint
from rce.commands import map_jobs
from rce.errors import InvalidRequest, NotFound, Unauthorized, Unavailable
from rce.map_jobs import MAPPERS, MapOptions
from rce.mapping import mappers
from rce.mapservice.work import Report

CONTENT = b"\x89MCAP0\r\n" + random.Random(1).randbytes(3_000_000)


class Cutter:
    """A way to the service on which connections break after so many bytes, as long as `cuts` lasts."""

    def __init__(self, url: str) -> None:
        self._to = url.split("/")[2].split(":")
        self.cuts: list[int] = []
        self.passed = 0

    async def start(self) -> str:
        self._server = await asyncio.start_server(self._join, "127.0.0.1", 0)
        return f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}/"

    async def _join(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        up, down = await asyncio.open_connection(*self._to)
        left = self.cuts[0] if self.cuts else None

        async def answers() -> None:
            while data := await up.read(65536):
                writer.write(data)
            writer.close()

        back = asyncio.create_task(answers())
        try:
            while data := await reader.read(65536):
                self.passed += len(data)
                if left is not None and (left := left - len(data)) < 0:
                    self.cuts.pop(0)
                    writer.transport.abort()
                    break
                down.write(data)
                await down.drain()
        except ConnectionError:
            pass
        finally:
            down.close()
            await asyncio.wait({back})

    def stop(self) -> None:
        self._server.close()


@pytest.fixture
async def cutter(service: Service) -> AsyncIterator[Cutter]:
    cutter = Cutter(service.url)
    cutter.url = await cutter.start()  # type: ignore[attr-defined]
    yield cutter
    cutter.stop()


def client(url: str, key: str = "rce_ann", patience: float = 20.0) -> MapService:
    return MapService(url, key=key, patience=patience)


async def off(work: Any, *arguments: Any) -> Any:
    """A blocking call, in a thread."""
    return await asyncio.to_thread(work, *arguments)


async def test_an_upload_goes_on_where_the_connection_broke(service: Service, cutter: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(CONTENT)
    cutter.cuts = [700_000, 900_000]
    told: list[int] = []
    upload = await off(client(cutter.url).upload, path, told.append)
    assert upload.offset == len(CONTENT)
    assert service.service.uploads.path(upload.id).read_bytes() == CONTENT
    assert cutter.cuts == [], "both cuts have happened"
    assert cutter.passed < 2 * len(CONTENT), "what was there was not sent again"
    assert told[-1] == len(CONTENT)


async def test_another_run_takes_over_what_is_there(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(CONTENT)
    half = service.service.uploads.create("ann", path.name, len(CONTENT), fingerprint(path)).id
    service.service.uploads.path(half).write_bytes(CONTENT[:1_000_000])
    told: list[int] = []
    upload = await off(client(service.url).upload, path, told.append)
    assert (upload.id, told[0]) == (half, 1_000_000)
    assert service.service.uploads.path(half).read_bytes() == CONTENT
    assert (await off(client(service.url).upload, path)).id == half, "a file that is there is not sent again"
    path.write_bytes(CONTENT[:-1] + b"x")
    assert (await off(client(service.url).upload, path)).id != half


async def test_what_is_no_recording_is_refused_before_it_is_sent(service: Service, cutter: Any, tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    path.write_bytes(bytes(5_000_000))
    with pytest.raises(InvalidRequest, match="not a ROS 1 bag"):
        await off(client(cutter.url).upload, path)
    assert cutter.passed < 200_000


async def test_a_job_is_watched_and_fetched(service: Service, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(LOG)
    maps = client(service.url)
    upload = await off(maps.upload, path)
    job = await off(maps.submit, [upload.id], MapOptions(mapper="particle", resolution=0.1), "corridor")
    assert (job.recording, job.options.mapper) == ("corridor", "particle")
    watching = asyncio.create_task(off(lambda: [seen.state for seen in maps.watch(job.id)]))
    service.workers.tell(job.id, Report("mapping", 3))
    await asyncio.sleep(0.05)
    service.workers.finish(job.id)
    assert (await watching)[-1] == "done"
    await off(maps.fetch, job.id, "map.png", tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes() == b"a picture"
    with pytest.raises(NotFound):
        await off(maps.fetch, job.id, "map.pgm", tmp_path / "map.pgm")
    assert sorted(os.listdir(tmp_path)) == ["a.log", "map.png", "maps"]
    assert [each.id for each in await off(maps.jobs)] == [job.id]
    await off(maps.remove, job.id)
    with pytest.raises(NotFound):
        await off(maps.job, job.id)


async def test_a_cancelled_job_is_not_told_as_a_map(service: Service, tmp_path: Path, capsys: Any) -> None:
    job = await service.submit()
    await service.ask("POST", f"/jobs/{job}/cancel")
    assert await off(map_jobs.finish, client(service.url), job, tmp_path / "map") == 1
    assert capsys.readouterr().out.startswith("cancelled; in ")


async def test_errors_say_what_is_wrong(service: Service, tmp_path: Path) -> None:
    with pytest.raises(Unauthorized):
        await off(client(service.url, key="rce_nobody").jobs)
    with pytest.raises(Unavailable, match="cannot reach"):
        await off(client("http://127.0.0.1:1/", patience=0.1).jobs)
    with pytest.raises(InvalidRequest, match="http://"):
        client("no url")


def test_the_mappers_are_those_of_the_node() -> None:
    assert set(MAPPERS) == set(mappers.MAPPERS)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--resolution", "9"), "--resolution: "),
        (("--max-range", "0.1"), "--max-range: "),
        (("--scan-topic", "scan topic"), "--scan-topic: "),
    ],
)
def test_options_that_are_wrong_are_named(words: tuple[str, ...], reason: str) -> None:
    given: argparse.Namespace = map_jobs.parser().parse_args(["submit", "a.log", *words])
    with pytest.raises(InvalidRequest, match=reason):
        map_jobs.options_of(given)


@pytest.mark.parametrize(
    ("name", "sent"), [("my log.log", "my_log.log"), (".a-1.bag", "a-1.bag"), ("käse/2.bag", "k_se_2.bag")]
)
def test_names_that_the_service_takes(name: str, sent: str) -> None:
    assert map_jobs.safe(name) == sent


def test_the_files_of_a_recording(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        map_jobs.files_of(tmp_path / "nothing.log")
    with pytest.raises(InvalidRequest, match=r"no metadata\.yaml"):
        map_jobs.files_of(tmp_path)
    for name in ("metadata.yaml", "a.mcap", ".hidden"):
        (tmp_path / name).touch()
    assert [path.name for path in map_jobs.files_of(tmp_path)] == ["a.mcap", "metadata.yaml"]

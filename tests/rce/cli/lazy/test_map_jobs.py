"""The commands for jobs of the map service: options, files of a recording, and the result of a job."""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import msgspec
import pytest

from rce.api.map_jobs import MapOptions
from rce.cli.lazy import map_jobs
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest, NotFound
from tests.support.map_service import Service


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    async with Service(tmp_path / "maps") as service:
        yield service


async def test_cancelled_job_is_not_reported_as_a_map(
    service: Service, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = await service.submit()
    await service.request("POST", f"/jobs/{job}/cancel")
    client = MapServiceClient(service.url, key="rce_ann")
    assert await asyncio.to_thread(map_jobs.finish, client, job, tmp_path / "map") == 1
    assert capsys.readouterr().out.startswith("cancelled; in ")


@pytest.mark.parametrize(
    ("option", "value"), [("resolution", 9.0), ("max_range", 0.1), ("scan_topic", "scan topic"), ("mapper", "none")]
)
def test_invalid_option_is_named(option: str, value: object) -> None:
    args = argparse.Namespace(**msgspec.structs.asdict(MapOptions()) | {option: value})
    with pytest.raises(InvalidRequest, match=f"--{option.replace('_', '-')}: "):
        map_jobs.map_options(args)


@pytest.mark.parametrize(
    ("name", "sent"), [("my log.log", "my_log.log"), (".a-1.bag", "a-1.bag"), ("käse/2.bag", "k_se_2.bag")]
)
def test_characters_that_the_service_refuses_are_replaced(name: str, sent: str) -> None:
    assert map_jobs.upload_name(name) == sent


def test_files_of_a_recording(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        map_jobs.files_of(tmp_path / "nothing.log")
    with pytest.raises(InvalidRequest, match=r"no metadata\.yaml"):
        map_jobs.files_of(tmp_path)
    for name in ("metadata.yaml", "a.mcap", ".hidden"):
        (tmp_path / name).touch()
    assert [path.name for path in map_jobs.files_of(tmp_path)] == ["a.mcap", "metadata.yaml"]


def test_recordings_share_a_job_if_they_are_mapped_in_parallel(tmp_path: Path) -> None:
    recordings = [tmp_path / "my first.log", tmp_path / "second.bag", tmp_path / "bag"]
    for recording in recordings[:2]:
        recording.touch()
    recordings[2].mkdir()
    for name in ("metadata.yaml", "a b.mcap"):
        (recordings[2] / name).touch()
    alone = map_jobs.submissions(recordings, 1)
    assert [(name, [upload for _, upload in files]) for name, files in alone] == [
        ("my first.log", ["my_first.log"]),
        ("second.bag", ["second.bag"]),
        ("bag", ["a b.mcap", "metadata.yaml"]),
    ]
    ((name, files),) = map_jobs.submissions(recordings[:2], 4)
    assert (name, [upload for _, upload in files]) == ("2 recordings", ["my_first.log", "second.bag"])
    assert map_jobs.submissions(recordings[2:], 4) == alone[2:]
    with pytest.raises(InvalidRequest, match="cannot share a job"):
        map_jobs.submissions(recordings, 2)

"""The map service in a real platform: command line, SOAP, and restarts of Master and service."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zeep
from requests import Session
from zeep.transports import Transport
from zeep.wsse.username import UsernameToken

from rce.api.map_jobs import Job
from rce.client.map_service import MapServiceClient
from tests.support.e2e.mapping import TIMEOUT, rce
from tests.support.e2e.real_platform import USER, RealPlatform, until
from tests.support.e2e.recordings import LOG, piece
from tests.support.paths import DATA

RESULTS = ["log.txt", "map.pgm", "map.png", "map.yaml", "times.json", "trajectory.txt"]
MANY = 1900  # scans; mapping them takes far longer than a restart of the Master
SERVICE = r"-m rce\.mapservice "
MASTER = r"-m master "

pytestmark = pytest.mark.skipif(not LOG.exists(), reason=f"needs {LOG.name} in {DATA}, or RCE_DATA")


def maps(platform: RealPlatform) -> MapServiceClient:
    return MapServiceClient(platform.url, user=USER, password=USER)


@pytest.fixture
async def wsdl(platform: RealPlatform) -> str:
    service = maps(platform)
    await asyncio.to_thread(service.jobs)
    return f"{service._base}/map-service/soap?wsdl"


async def test_soap_and_command_line(platform: RealPlatform, wsdl: str, tmp_path: Path) -> None:
    """Submit a recording by SOAP, fetch its map by `rce map fetch` and by SOAP."""
    recording = piece(tmp_path / "piece.log", 100)
    with Session() as session:

        def call(name: str, **arguments: Any) -> Any:
            client = zeep.Client(wsdl, wsse=UsernameToken(USER, USER), transport=Transport(session=session))
            return getattr(client.service, name)(**arguments)

        content = {"name": recording.name, "content": recording.read_bytes()}
        job = await asyncio.to_thread(call, "SubmitMap", recording=content, options={"resolution": 0.1})
        assert job.state in ("queued", "running")
        status, output, errors = await rce("map", "fetch", job.id, "--url", platform.url, "--out", tmp_path / "map")
        assert status == 0, errors
        assert "scans mapped" in output
        assert sorted(path.name for path in (tmp_path / "map").iterdir()) == RESULTS
        assert "resolution: 0.1" in (tmp_path / "map" / "map.yaml").read_text()
        result = await asyncio.to_thread(call, "GetResult", job=job.id, file=["map.pgm"])
        files = {file.name: file for file in result.file}
        assert sorted(files) == RESULTS
        assert files["map.pgm"].content == (tmp_path / "map" / "map.pgm").read_bytes()
        assert result.job.state == "done"
        with pytest.raises(zeep.exceptions.Fault, match="no job"):
            await asyncio.to_thread(call, "GetStatus", job="0" * 24)
    status, output, _ = await rce("map", "status", "--url", platform.url, "--json")
    assert (job.id, "piece.log", "done") in [
        (each["id"], each["recording"], each["state"]) for each in json.loads(output)
    ]
    times = json.loads((tmp_path / "map" / "times.json").read_text())
    assert set(times) == {"waiting", "opening", "preparing", "mapping", "writing", "total"}


@pytest.mark.parametrize(
    ("bag", "reason"),
    [
        ("wrong-index.bag", "damaged"),
        ("version-1.2.bag", "format 1.2"),
        ("tf_example", "no laser scans"),
        ("two-lidars.bag", "has no topic /nothing"),
    ],
)
async def test_malformed_recordings_are_refused(platform: RealPlatform, bag: str, reason: str) -> None:
    words = ["--scan-topic", "/nothing"] if bag == "two-lidars.bag" else []
    status, _, errors = await rce("map", "submit", DATA / "bags" / bag, "--url", platform.url, *words)
    assert status == 1
    assert reason in errors.splitlines()[-1]


async def test_job_survives_restarts_of_master_and_service(fragile: RealPlatform, tmp_path: Path) -> None:
    service = maps(fragile)
    upload = await asyncio.to_thread(service.upload, piece(tmp_path / "piece.log", MANY))
    job = await asyncio.to_thread(service.submit, [upload.id])

    async def mapping() -> Job:
        """Return the job when a part of it is mapped, or when it has ended."""

        def watch() -> Job:
            return next(seen for seen in service.watch(job.id) if seen.scans > 20 or seen.ended)

        return await asyncio.wait_for(asyncio.to_thread(watch), TIMEOUT)

    assert (await mapping()).state == "running"
    old = fragile.pid(MASTER)
    fragile.kill(old)
    await until(lambda: fragile.pid(MASTER, but=old))
    seen = await mapping()
    assert seen.error is None
    assert seen.state == "running", "the job ended too soon for this test"
    old = fragile.pid(SERVICE)
    fragile.kill(old)
    await until(lambda: fragile.pid(SERVICE, but=old))
    last = await asyncio.wait_for(asyncio.to_thread(lambda: [*service.watch(job.id)][-1]), TIMEOUT)
    assert last.state == "done", last
    assert last.scans == MANY
    await asyncio.to_thread(service.fetch, job.id, "trajectory.txt", tmp_path / "trajectory.txt")
    assert np.loadtxt(tmp_path / "trajectory.txt").shape == (MANY, 4)
    environments = fragile.directory / "data" / "container" / "environments"
    await until(lambda: not list(environments.iterdir()), what="the environment of the first attempt is removed")


async def test_benchmark_of_a_large_recording() -> None:
    """With 200 MB instead of 4 GB: memory is bounded, and another user's job is done meanwhile."""
    status, output, errors = await rce("bench", "map-service", "--size", "200", "--json")
    assert status == 0, errors
    found = json.loads(output)
    assert found["size"] > 190_000_000
    assert found["peak"] - found["idle"] < 100_000_000
    assert found["meanwhile"]

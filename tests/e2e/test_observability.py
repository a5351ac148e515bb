"""Observability of a real platform: metrics of all processes, traces of messages, ids of requests in logs."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urlencode

import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families

from rce.api import views
from rce.api.client import ApiClient
from rce.api.http import EntryClient, basic
from rce.api.roles import Scopes
from rce.cli.commands.tracing import paths
from rce.client import Robot
from rce.errors import Unavailable
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import ROOT

DASHBOARD = ROOT / "docs" / "grafana" / "rce.json"
DOCUMENT, CONFIGURATION = DASHBOARD.parents[1] / "observability.md", DASHBOARD.with_name("prometheus.yml")
TYPE = "std_msgs/String"
STEPS = ["sent", "received", "delivered", "total"]
SCRAPE_INTERVAL = "3s"  # also the limit for each, on a busy machine


@pytest.fixture
async def robot(platform: RealPlatform) -> AsyncIterator[Robot]:
    """A robot with an environment and a node in it that sends back what it receives."""
    async with platform.robot("observer") as robot:
        await robot.create_environment("observed")
        await robot.add_node("observed", "relay", "Relay", "relay.py", args=TYPE)
        await robot.add_interface("observed", "into", "PublisherInterface", TYPE, addr="/in_String")
        await robot.add_interface("observed", "out", "SubscriberInterface", TYPE, addr="/out_String")
        yield robot
        await robot.destroy_environment("observed")


async def test_messages_metrics_and_requests_can_be_traced(platform: RealPlatform, robot: Robot) -> None:
    publisher = await robot.publisher("say", TYPE, to="observed/into")
    subscriber = await robot.subscriber("hear", TYPE, to="observed/out")

    def follow() -> list[views.MessageTrace]:
        api = ApiClient(platform.url, user="testUser", password="testUser")
        return api.get(views.Traced, "interfaces", "observer", "say", "trace", messages=10, seconds=60).messages

    heard = asyncio.ensure_future(anext(aiter(subscriber)))
    while not heard.done():
        await publisher.publish({"data": "hello"})
        await asyncio.wait([heard], timeout=0.1)
    following = asyncio.create_task(asyncio.to_thread(follow))
    while not following.done():
        await publisher.publish({"data": "hello"})
        await asyncio.wait([following], timeout=0.1)
    traced = await following
    assert len({each.message for each in traced}) == 10
    found = [dict(paths(each)) for each in traced]
    complete = [each for each in found if list(each.get("observed/into", [])) == STEPS]
    assert complete, found  # the first were on their way when one of the endpoints began to record
    assert all(each.keys() == {"observed/into"} for each in complete)
    assert all(0 < microseconds < 60e6 for each in complete for microseconds in each["observed/into"].values())

    named = set(re.findall(r"\b((?:rce|process)_\w+)", " ".join(await asyncio.to_thread(_expressions))))
    known = await asyncio.to_thread(_metrics, platform.url)
    assert {_family(name) for name in named | _documented()} <= known

    lines = [json.loads(line) for line in platform.log.split("\n") if line.startswith("{")]
    (id,) = {line["request"] for line in lines if line["message"] == "robot testUser/observer: CreateContainer"}
    log = platform.directory / "data" / "container" / "environments" / "testUser" / "observed"
    (inside,) = [file.read_text() for file in log.glob("*/endpoint.log")]
    assert "endpoints.robot.session" in {line["from"] for line in lines if line.get("request") == id}
    assert "started testUser/observed" in {line["message"] for line in lines if line.get("request") == id}
    node = next(line for line in lines if line["message"] == "robot testUser/observer: AddNode")["request"]
    assert f'"request":"{node}"' in inside


async def test_prometheus_scrapes_all_processes(platform: RealPlatform, robot: Robot, tmp_path: Path) -> None:
    """With the configuration in the documentation."""
    program = shutil.which("prometheus")
    if program is None:
        pytest.skip("no Prometheus: apt-get install prometheus")
    admin = ApiClient(platform.url, user="admin", password="admin")
    body = views.NewKey("operator", "prometheus", scopes=Scopes(metrics=True))
    key = (await asyncio.to_thread(admin.post, views.CreatedKey, "keys", body=body)).secret
    (tmp_path / "rce.key").write_text(key)
    text = CONFIGURATION.read_text()
    for old, new in {
        "/etc/prometheus/rce.key": str(tmp_path / "rce.key"),
        "http://127.0.0.1:9000/": platform.url,
        "10s": SCRAPE_INTERVAL,
        "15s": "1s",
    }.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "prometheus.yml").write_text(text)
    words = ["--config.file=prometheus.yml", "--storage.tsdb.path=data", "--web.listen-address=127.0.0.1:0"]
    with (tmp_path / "log").open("wb") as log:
        process = await asyncio.create_subprocess_exec(program, *words, cwd=tmp_path, stderr=log)
    up: dict[str, str] = {}
    ready: dict[str, str] = {}
    try:
        async with asyncio.timeout(120):
            address = await _listening_address(process)
            while len(up) < 6 or "0" in up.values():
                await asyncio.sleep(0.2)
                up = await asyncio.to_thread(_query, address, "up")
            while not ready:  # as after a scrape that took too long
                ready = await asyncio.to_thread(_query, address, 'rce_environments{state="ready"}')
        assert set(up) == {"master", "robot-1", "machine-1", "map-service", "knowledge-service", "testUser/observed"}
        assert ready == {"master": "1"}
    except BaseException as error:
        error.add_note(f"{up}\n{(tmp_path / 'log').read_text()}")
        raise
    finally:
        if process.returncode is None:
            process.terminate()
        await process.wait()


async def _listening_address(process: asyncio.subprocess.Process) -> str:
    """Return the address that Prometheus listens at, which it does not log, once it does."""
    while True:
        assert process.returncode is None
        for connection in psutil.Process(process.pid).net_connections("tcp"):
            if connection.status == psutil.CONN_LISTEN:
                return f"{connection.laddr.ip}:{connection.laddr.port}"
        await asyncio.sleep(0.05)


def _query(address: str, query: str) -> dict[str, str]:
    """Return the current value of each series by its instance; empty while Prometheus is starting."""
    try:
        answer = EntryClient(f"http://{address}/", {}).json("GET", f"api/v1/query?{urlencode({'query': query})}")
    except Unavailable:
        return {}
    result = json.loads(answer)["data"]["result"]
    return {each["metric"]["instance"]: each["value"][1] for each in result}


def _family(name: str) -> str:
    return re.sub(r"_(bucket|count|total)$", "", name)


def _documented() -> set[str]:
    """Return the metrics in the table of the documentation, without those of agents, which exist in swarms only."""
    rows = [line.split("|") for line in DOCUMENT.read_text().splitlines() if line.startswith("| `rce_")]
    return {name for row in rows if row[2].strip() != "agents" for name in re.findall(r"`(rce_\w+)`", row[1])}


def _expressions() -> list[str]:
    return [each["expr"] for panel in json.loads(DASHBOARD.read_text())["panels"] for each in panel.get("targets", [])]


def _metrics(url: str) -> set[str]:
    """Return the names of all metrics of all processes, found as Prometheus does."""
    entry = EntryClient(url, basic("admin", "admin"))
    targets = entry.json("GET", "metrics/targets")
    found: set[str] = set()
    for target in json.loads(targets):
        with entry.open("GET", target["labels"]["__metrics_path__"].lstrip("/")) as answer:
            found |= {family.name for family in text_string_to_metric_families(answer.read().decode())}
    return found

"""A real platform observed: metrics of all processes, one message hop by hop, one id in all logs."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from urllib.parse import urlencode

import pytest
from prometheus_client.parser import text_string_to_metric_families
from real_platform import RealPlatform

from rce import views
from rce.api import Api
from rce.client import Robot
from rce.console.tracing import paths
from rce.errors import Unavailable
from rce.http import Entry, basic
from rce.roles import Scopes

DASHBOARD = Path(__file__).parents[2] / "docs" / "grafana" / "rce.json"
DOCUMENT, CONFIGURATION = DASHBOARD.parents[1] / "observability.md", DASHBOARD.with_name("prometheus.yml")
TYPE = "std_msgs/String"


@pytest.fixture
async def robot(platform: RealPlatform) -> AsyncIterator[Robot]:
    """With a node in an environment of its own that sends back what it gets."""
    async with platform.robot("observer") as robot:
        await robot.create_environment("observed")
        await robot.add_node("observed", "relay", "Relay", "relay.py", args=TYPE)
        await robot.add_interface("observed", "into", "PublisherInterface", TYPE, addr="/in_String")
        await robot.add_interface("observed", "out", "SubscriberInterface", TYPE, addr="/out_String")
        yield robot
        await robot.destroy_environment("observed")


async def test_what_happens_can_be_seen(platform: RealPlatform, robot: Robot) -> None:
    publisher = await robot.publisher("say", TYPE, to="observed/into")
    subscriber = await robot.subscriber("hear", TYPE, to="observed/out")

    def follow() -> list[views.MessageTrace]:
        api = Api(platform.url, user="testUser", password="testUser")
        return api.get(views.Traced, "interfaces", "observer", "say", "trace", messages=1, seconds=30).messages

    heard = asyncio.ensure_future(anext(aiter(subscriber)))
    while not heard.done():
        await publisher.publish({"data": "hello"})
        await asyncio.wait([heard], timeout=0.1)
    following = asyncio.create_task(asyncio.to_thread(follow))
    while not following.done():
        await publisher.publish({"data": "hello"})
        await asyncio.wait([following], timeout=0.1)
    ((to, row),) = paths((await following)[0])
    assert to == "observed/into"
    assert list(row) == ["sent", "received", "delivered", "total"]
    assert all(0 < microseconds < 5e6 for microseconds in row.values())

    named = set(re.findall(r"\b((?:rce|process)_\w+)", " ".join(await asyncio.to_thread(_expressions))))
    known = await asyncio.to_thread(_metrics, platform.url)
    assert {_family(name) for name in named | _documented()} <= known

    lines = [json.loads(line) for line in platform.log.splitlines() if line.startswith("{")]
    (id,) = {line["request"] for line in lines if line["message"] == "robot testUser/observer: CreateContainer"}
    log = platform.directory / "data" / "container" / "environments" / "testUser" / "observed"
    (inside,) = [file.read_text() for file in log.glob("*/endpoint.log")]
    assert "endpoints.robot.session" in {line["from"] for line in lines if line.get("request") == id}
    assert "testUser/observed is started" in {line["message"] for line in lines if line.get("request") == id}
    node = next(line for line in lines if line["message"] == "robot testUser/observer: AddNode")["request"]
    assert f'"request":"{node}"' in inside


async def test_prometheus_reads_it(platform: RealPlatform, robot: Robot, tmp_path: Path) -> None:
    """With the configuration that the documentation has."""
    program = shutil.which("prometheus")
    if program is None:
        pytest.skip("no Prometheus: apt-get install prometheus")
    admin = Api(platform.url, user="admin", password="admin")
    body = views.NewKey("operator", "prometheus", scopes=Scopes(metrics=True))
    key = (await asyncio.to_thread(admin.post, views.MadeKey, "keys", body=body)).secret
    (tmp_path / "rce.key").write_text(key)
    text = CONFIGURATION.read_text()
    for old, new in {
        "/etc/prometheus/rce.key": str(tmp_path / "rce.key"),
        "http://127.0.0.1:9000/": platform.url,
        "10s": "1s",
        "15s": "1s",
    }.items():
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "prometheus.yml").write_text(text)
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"127.0.0.1:{free.getsockname()[1]}"
    words = ["--config.file=prometheus.yml", "--storage.tsdb.path=data", f"--web.listen-address={address}"]
    with (tmp_path / "log").open("wb") as log:
        process = await asyncio.create_subprocess_exec(program, *words, cwd=tmp_path, stderr=log)
    up: dict[str, str] = {}
    try:
        async with asyncio.timeout(60):
            while len(up) < 5 or "0" in up.values():
                await asyncio.sleep(0.5)
                assert process.returncode is None
                up = await asyncio.to_thread(_ask_prometheus, address, "up")
        assert set(up) == {"master", "robot-1", "machine-1", "map-service", "testUser/observed"}
        found = await asyncio.to_thread(_ask_prometheus, address, 'rce_environments{state="ready"}')
        assert found == {"master": "1"}
    except BaseException as error:
        error.add_note(f"{up}\n{(tmp_path / 'log').read_text()}")
        raise
    finally:
        if process.returncode is None:
            process.terminate()
        await process.wait()


def _ask_prometheus(address: str, query: str) -> dict[str, str]:
    """The present value of each series by its instance; nothing while it does not listen."""
    try:
        answer = Entry(f"http://{address}/", {}).json("GET", f"api/v1/query?{urlencode({'query': query})}")
    except Unavailable:
        return {}
    result = json.loads(answer)["data"]["result"]
    return {each["metric"]["instance"]: each["value"][1] for each in result}


def _family(name: str) -> str:
    return re.sub(r"_(bucket|count|total)$", "", name)


def _documented() -> set[str]:
    """The metrics of the documentation's table, but those of agents alone, which are in swarms only."""
    rows = [line.split("|") for line in DOCUMENT.read_text().splitlines() if line.startswith("| `rce_")]
    return {name for row in rows if row[2].strip() != "agents" for name in re.findall(r"`(rce_\w+)`", row[1])}


def _expressions() -> list[str]:
    return [each["expr"] for panel in json.loads(DASHBOARD.read_text())["panels"] for each in panel.get("targets", [])]


def _metrics(url: str) -> set[str]:
    """The names of all metrics of all processes, as Prometheus finds them."""
    entry = Entry(url, basic("admin", "admin"))
    targets = entry.json("GET", "metrics/targets")
    found: set[str] = set()
    for target in json.loads(targets):
        with entry.open("GET", target["labels"]["__metrics_path__"].lstrip("/")) as answer:
            found |= {family.name for family in text_string_to_metric_families(answer.read().decode())}
    return found

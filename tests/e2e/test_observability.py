"""A real platform observed: metrics of all processes, one message hop by hop, one id in all logs."""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families
from real_platform import RealPlatform

from rce import views
from rce.api import Api
from rce.client import Robot
from rce.console.tracing import paths
from rce.http import Entry, basic

DASHBOARD = Path(__file__).parents[2] / "docs" / "grafana" / "rce.json"
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
    assert {re.sub(r"_(bucket|count|total)$", "", name) for name in named} <= known

    lines = [json.loads(line) for line in platform.log.splitlines() if line.startswith("{")]
    (id,) = {line["request"] for line in lines if line["message"] == "robot testUser/observer: CreateContainer"}
    log = platform.directory / "data" / "container" / "environments" / "testUser" / "observed"
    (inside,) = [file.read_text() for file in log.glob("*/endpoint.log")]
    assert "endpoints.robot.session" in {line["from"] for line in lines if line.get("request") == id}
    assert "testUser/observed is started" in {line["message"] for line in lines if line.get("request") == id}
    node = next(line for line in lines if line["message"] == "robot testUser/observer: AddNode")["request"]
    assert f'"request":"{node}"' in inside


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

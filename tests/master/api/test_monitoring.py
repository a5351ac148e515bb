"""`/healthz`, `/readyz` and `/metrics`."""

from __future__ import annotations

import asyncio
import http.client
import json

import pytest
from prometheus_client.parser import text_string_to_metric_families

from rce.api import http as client
from rce.control.calls.watching import Metrics, ReadMetrics
from rce.process.metrics import Family, Sample, gauge_family
from rce.protocol import messages as m
from tests.support.master.served import PASSWORD, Served


@pytest.fixture
async def served(served: Served) -> Served:
    await served.master.commands.execute("ann", m.CreateContainer("brain"))
    return served


async def ask(served: Served, path: str, user: str = "") -> tuple[int, str]:
    def do() -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", served.port, timeout=20)
        headers = client.basic(user, PASSWORD) if user else {}
        connection.request("GET", path, headers=headers | {"Connection": "close"})
        response = connection.getresponse()
        return response.status, response.read().decode()

    return await asyncio.to_thread(do)


def values(text: str) -> dict[str, float]:
    """Each sample by its name and the values of its labels."""
    return {
        " ".join([sample.name, *sample.labels.values()]): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


async def test_health_needs_no_credentials(served: Served) -> None:
    assert await ask(served, "/healthz") == (200, '{"status":"ok","missing":[]}')
    assert await ask(served, "/readyz") == (200, '{"status":"ok","missing":[]}')
    await served.leave("west")
    await served.leave("m1")
    status, text = await ask(served, "/readyz")
    assert status == 503
    endpoints, machines = json.loads(text)["missing"]
    assert "Robot endpoint" in endpoints
    assert "task set" in machines
    assert (await ask(served, "/healthz"))[0] == 200


async def test_database_that_does_not_answer_is_missing(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("master.storage.store.PATIENCE", 0.01)
    store = served.master._store
    hangs: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    asked = []

    async def run(work: object) -> None:
        asked.append(work)
        await hangs

    monkeypatch.setattr(store, "run", run)
    for _ in range(3):
        status, text = await ask(served, "/readyz")
        assert status == 503
        assert "database" in text
    assert len(asked) == 1, "who asks again and again does not pile up work"
    hangs.set_result(None)
    monkeypatch.setattr("master.storage.store.PATIENCE", 20.0)
    assert (await ask(served, "/readyz"))[0] == 200


async def test_metrics_of_the_master(served: Served) -> None:
    seen = values((await ask(served, "/metrics", "root"))[1])
    assert seen["rce_environments ready"] == 1
    assert seen["rce_environments waiting"] == 0
    assert seen["rce_processes robot joined"] == 1
    assert seen["rce_command_seconds_count CreateContainer"] >= 1
    assert seen["process_resident_memory_bytes"] > 1e6


async def test_metrics_need_the_right_to_read_them(served: Served) -> None:
    for path in ("/metrics", "/metrics/targets", "/metrics/west", "/metrics/ann/brain", "/metrics/nobody"):
        assert (await ask(served, path))[0] == 401
        for user in ("ann", "vera"):
            assert (await ask(served, path, user))[0] == 403
    assert (await ask(served, "/metrics", "olga"))[0] == 200
    assert (await ask(served, "/metrics/nobody", "olga"))[0] == 404


async def test_metrics_of_other_processes_come_through_the_master(served: Served) -> None:
    told = [
        gauge_family("rce_links", "Links", ["state"], {("up",): 3}),
        Family("rce_hop_seconds", "Time", "histogram", ["hop"], [Sample(["to_link"], 0.5, [1, 2, 4])], [0.1, 1.0]),
    ]
    served.peers["ann/brain"].answers[ReadMetrics] = Metrics(told)
    seen = values((await ask(served, "/metrics/ann/brain", "olga"))[1])
    assert seen == {
        "rce_links up": 3,
        "rce_hop_seconds_bucket to_link 0.1": 1,
        "rce_hop_seconds_bucket to_link 1.0": 3,
        "rce_hop_seconds_bucket to_link +Inf": 7,
        "rce_hop_seconds_count to_link": 7,
        "rce_hop_seconds_sum to_link": 0.5,
    }


@pytest.mark.parametrize(
    "family",
    [
        gauge_family("not a name\nrce_robots 5", "", [], {(): 1}),
        gauge_family("rce_links", "", ["state"], {("up", "too many"): 1}),
        Family("rce_hop_seconds", "", "histogram", [], [Sample([], 0.5, [1])], [0.1, 1.0]),
    ],
)
async def test_invalid_metrics_are_not_passed_on(served: Served, family: Family) -> None:
    served.peers["ann/brain"].answers[ReadMetrics] = Metrics([family])
    status, text = await ask(served, "/metrics/ann/brain", "olga")
    assert status == 400
    assert "reported invalid metrics" in text


async def test_scrape_targets_are_the_processes_that_have_joined(served: Served) -> None:
    await served.leave("west")
    found = json.loads((await ask(served, "/metrics/targets", "olga"))[1])
    assert {each["targets"][0] for each in found} == {f"127.0.0.1:{served.port}"}
    assert [each["labels"] for each in found] == [
        {"__scheme__": "http", "__metrics_path__": "/metrics", "instance": "master", "role": "master"},
        {
            "__scheme__": "http",
            "__metrics_path__": "/metrics/ann/brain",
            "instance": "ann/brain",
            "role": "environment",
            "user": "ann",
        },
        {"__scheme__": "http", "__metrics_path__": "/metrics/m1", "instance": "m1", "role": "container"},
    ]

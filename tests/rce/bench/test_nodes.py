"""Measuring nodes and their client."""

from __future__ import annotations

import json
from typing import Any, cast

import pytest

from rce.bench import nodes
from rce.bench.nodes import ECHO_TIMEOUT, RETRY_INTERVAL, MeasuringNode, drain, retry, start_connected
from rce.bench.payloads import IMAGE, ROW
from rce.client import Environment, Publisher, Subscriber
from rce.errors import TimedOut
from tests.support.bench import FakeEnvironment, Topic


class Node:
    """Node that answers each order with its size in microseconds, after `silent` orders that it does not hear."""

    def __init__(self, silent: int = 0) -> None:
        self.reports = Topic()
        self.orders = Topic(self._answer)
        self._silent = silent

    def _answer(self, message: dict[str, str]) -> None:
        order = json.loads(message["data"])
        if len(self.orders.sent) > self._silent:
            self.reports.messages.append({"data": json.dumps({**order, "seconds": order["size"] / 1e6})})

    @property
    def kinds(self) -> list[Any]:
        return [json.loads(each["data"])["kind"] for each in self.orders.sent]

    def client(self) -> MeasuringNode:
        return MeasuringNode(cast(Publisher, self.orders), cast(Subscriber, self.reports))


async def test_probe_orders_a_round_trip_of_its_kind_and_size() -> None:
    node = Node()
    string, image = node.client().probes("c2c", ["string", "image"], beside="n2n")
    assert await string.sample(1000) == 0.001
    assert json.loads(node.orders.sent[0]["data"]) == {"number": 1, "kind": "string", "size": 1000}
    assert (string.name, string.transport, string.beside, string.size) == ("c2c string", "topic", "n2n string", None)
    assert image.size == IMAGE


def test_probes_of_services_are_compared_with_nothing_unless_told() -> None:
    (service,) = Node().client().probes("n2n", ["service"])
    assert (service.transport, service.beside) == ("service", "")


async def test_late_report_of_an_earlier_order_is_ignored() -> None:
    node = Node()
    node.reports.messages.append({"data": json.dumps({"number": 0, "seconds": 9.0})})
    (probe,) = node.client().probes("n2n", ["bytes"])
    assert await probe.sample(2000) == 0.002


async def test_orders_are_repeated_until_the_echo_answers() -> None:
    node = Node(silent=2)
    await node.client().wait_for_echo(["string", "bytes"])
    assert node.kinds == ["string"] * 3 + ["bytes"]
    assert json.loads(node.orders.sent[0]["data"])["size"] == ROW


async def test_silent_echo_is_reported_after_a_bounded_number_of_attempts() -> None:
    attempts: list[float] = []

    async def attempt(timeout: float) -> None:  # noqa: ASYNC109
        attempts.append(timeout)
        raise TimedOut("nothing arrived")

    with pytest.raises(TimedOut, match="did not answer within 30 s"):
        await retry(attempt)
    assert attempts == [RETRY_INTERVAL] * round(ECHO_TIMEOUT / RETRY_INTERVAL)


async def test_late_answers_are_discarded() -> None:
    topic = Topic()
    topic.messages.extend([1, 2])
    await drain(cast(Subscriber, topic))
    assert not topic.messages


async def test_node_and_its_echo_start_in_their_environments(monkeypatch: pytest.MonkeyPatch) -> None:
    node, one = Node(), FakeEnvironment("one")
    other = FakeEnvironment("other", one.log)
    one.topics = {"/n2n/order": node.orders, "/n2n/report": node.reports}
    await start_connected(cast(Environment, one), cast(Environment, other), "n2n", ["string", "service"])
    assert one.log == [
        ("node", "other", "n2n_echo", "echo", "string:string service:service"),
        ("node", "one", "n2n_measure", "measure", "string service"),
    ]
    assert node.kinds == ["string", "service"]
    assert nodes.PACKAGE == "rce_bench"

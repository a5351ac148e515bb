"""Routes between two environments."""

from __future__ import annotations

from contextlib import AsyncExitStack
from typing import Any, cast

import pytest

from rce.bench import pairs
from rce.bench.nodes import MeasuringNode
from rce.client import Environment, Publisher, Subscriber
from rce.errors import InvalidRequest
from tests.support.bench import Topic, fake_place


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str, str]]:
    """Environments of measuring and echo nodes that were started, and their namespaces; both answer at once."""
    pairs_of_nodes: list[tuple[str, str, str]] = []

    async def start(measure: Environment, echo: Environment, namespace: str, kinds: object) -> MeasuringNode:
        pairs_of_nodes.append((measure.tag, echo.tag, namespace))
        return MeasuringNode(cast(Publisher, Topic()), cast(Subscriber, Topic()))

    async def wait_for_echo(self: MeasuringNode, kinds: object) -> None:
        return

    monkeypatch.setattr(pairs, "start", start)
    monkeypatch.setattr(pairs, "start_connected", start)
    monkeypatch.setattr(MeasuringNode, "wait_for_echo", wait_for_echo)
    return pairs_of_nodes


async def test_environments_of_one_machine_are_connected_in_both_directions(
    started: list[tuple[str, str, str]],
) -> None:
    async with AsyncExitStack() as stack:
        place, environment, _ = fake_place(stack)
        probes = await pairs.c2c(place)
        log = [entry for entry in environment.log if entry[0] == "connect"]
    assert [probe.name for probe in probes] == ["c2c string", "c2c bytes", "c2c service"]
    assert log == [
        ("connect", "bench/string_out", "bench_c2c/string_in"),
        ("connect", "bench_c2c/string_back_out", "bench/string_back_in"),
        ("connect", "bench/bytes_out", "bench_c2c/bytes_in"),
        ("connect", "bench_c2c/bytes_back_out", "bench/bytes_back_in"),
        ("connect", "bench/service", "bench_c2c/service"),
    ]
    assert started == [("bench", "bench_c2c", "c2c")]


async def test_sides_of_a_connection_have_the_same_topic_and_opposite_directions() -> None:
    async with AsyncExitStack() as stack:
        place, environment, _ = fake_place(stack)
        await pairs.c2c(place)
    interfaces: dict[str, Any] = {name: entry for kind, name, *entry in environment.log if kind == "interface"}
    assert interfaces["bench/string_out"] == ["SubscriberInterface", "/c2c/string"]
    assert interfaces["bench_c2c/string_in"] == ["PublisherInterface", "/c2c/string"]
    assert interfaces["bench/service"] == ["ServiceProviderInterface", "/c2c/service"]
    assert interfaces["bench_c2c/service"] == ["ServiceClientInterface", "/c2c/service"]


async def test_environments_of_two_machines_have_a_special_feature_each(started: list[tuple[str, str, str]]) -> None:
    async with AsyncExitStack() as stack:
        place, environment, _ = fake_place(stack, "left", "right")
        await pairs.c2c2(place)
        made = [entry[1:] for entry in environment.log if entry[0] == "environment"]
    assert [(tag, options["special_features"]) for tag, options in made] == [
        ("bench_on_left", ["left"]),
        ("bench_on_right", ["right"]),
    ]
    assert started == [("bench_on_left", "bench_on_right", "c2c2")]
    assert environment.log[-2:] == [("destroyed", "bench_on_right"), ("destroyed", "bench_on_left")]


@pytest.mark.parametrize("features", [[], ["left"], ["a", "b", "c"]])
async def test_two_machines_need_two_features(features: list[str]) -> None:
    async with AsyncExitStack() as stack:
        with pytest.raises(InvalidRequest, match="--features ONE,OTHER"):
            await pairs.c2c2(fake_place(stack, *features)[0])


async def test_environments_of_a_group_need_no_interfaces(started: list[tuple[str, str, str]]) -> None:
    async with AsyncExitStack() as stack:
        place, environment, _ = fake_place(stack)
        probes = await pairs.group(place)
        log = environment.log[:]
    assert [(entry[1], entry[2]["group"]) for entry in log] == [("bench_group0", "bench"), ("bench_group1", "bench")]
    assert [probe.beside for probe in probes] == ["n2n string", "n2n bytes", "n2n service"]
    assert started == [("bench_group0", "bench_group1", "group")]

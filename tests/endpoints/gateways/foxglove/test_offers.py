"""Channels and services of an environment, and its connection graph."""

from __future__ import annotations

import asyncio

import pytest

from converters.definition import Definition
from endpoints.gateways.foxglove import offers
from endpoints.gateways.foxglove.offers import Offers
from rce.codecs.names import FOXGLOVE, FOXGLOVE_CLOUD
from rce.control.calls.robots import Sort
from rce.control.calls.watching import RosGraph, RosName, RosNode
from rce.errors import Unavailable
from tests.support.endpoints.fake_guest import FakeGuest

CHAT = RosName("/chat", ["std_msgs/msg/String"], 1)
UNKNOWN = RosName("/odd", ["odd_msgs/msg/Odd"], 1)
SILENT = RosName("/silent", ["std_msgs/msg/String"], 0, 1)
SET = RosName("/set", ["std_srvs/srv/SetBool"])


@pytest.fixture
async def guest() -> FakeGuest:
    return FakeGuest()


async def test_channels_come_and_go_with_their_publishers(guest: FakeGuest) -> None:
    topics = Offers(guest.as_guest(), "msg")
    changes = await topics.update(RosGraph([CHAT, UNKNOWN, SILENT], []))
    ((number, offer),) = changes.added.items()
    assert offers.channel(number, offer) == {
        "id": number,
        "topic": "/chat",
        "encoding": "cdr",
        "schemaName": "std_msgs/msg/String",
        "schemaEncoding": "ros2msg",
        "schema": "string data\n",
    }
    assert await topics.update(RosGraph([CHAT], [])) == ({}, [])
    assert await topics.update(RosGraph([], [])) == ({}, [number])
    again = await topics.update(RosGraph([CHAT], []))
    assert list(again.added) == [number + 1], "numbers are not used twice"


async def test_topics_are_offered_as_packets_too(guest: FakeGuest) -> None:
    camera, cloud = RosName("/camera", ["sensor_msgs/msg/Image"], 1), RosName("/points", ["sensor_msgs/PointCloud2"], 1)
    taken = RosName("/taken", ["sensor_msgs/msg/Image"], 1), RosName("/taken/h264", ["std_msgs/msg/String"], 1)
    topics = Offers(guest.as_guest(), "msg", ("h264", "draco"))
    odd = RosName("/dds", ["no type of ROS"], 1)
    changes = await topics.update(RosGraph([CHAT, camera, cloud, odd, *taken], []))
    packed = {each.name: (each.type, each.codec) for each in changes.added.values() if each.codec}
    assert packed == {"/camera/h264": (FOXGLOVE, "h264"), "/points/draco": (FOXGLOVE_CLOUD, "draco")}
    assert len(changes.added) == 7, "with the topics themselves"
    gone = await topics.update(RosGraph([CHAT, cloud, *taken], []))
    assert {changes.added[number].name for number in gone.removed} == {"/camera", "/camera/h264"}


async def test_type_that_takes_long_does_not_delay_others(guest: FakeGuest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offers, "PATIENCE", 0.01)
    topics, definitions, gate = Offers(guest.as_guest(), "msg"), guest.definitions, asyncio.Event()
    asked: list[str] = []

    async def slow(type: str, sort: Sort) -> dict[str, Definition]:
        asked.append(type)
        if type.startswith("sensor_msgs"):
            await gate.wait()
        return await definitions(type, sort)

    monkeypatch.setattr(guest, "definitions", slow)
    graph = RosGraph([CHAT, RosName("/scan", ["sensor_msgs/msg/LaserScan"], 1)], [])
    assert [offer.name for offer in (await topics.update(graph)).added.values()] == ["/chat"]
    assert not (await topics.update(graph)).added
    gate.set()
    assert [offer.name for offer in (await topics.update(graph)).added.values()] == ["/scan"]
    assert len(asked) == 2


async def test_services_have_schemas_of_both_directions(guest: FakeGuest) -> None:
    changes = await Offers(guest.as_guest(), "srv").update(RosGraph([CHAT], [SET]))
    ((number, offer),) = changes.added.items()
    record = offers.service(number, offer)
    assert (record["name"], record["type"]) == ("/set", "std_srvs/srv/SetBool")
    assert record["response"] == {
        "encoding": "cdr",
        "schemaName": "std_srvs/srv/SetBool_Response",
        "schemaEncoding": "ros2msg",
        "schema": "bool success\nstring message\n",
    }


def test_connection_graph_is_told_by_its_changes() -> None:
    before = offers.connections(RosGraph([], [], [], [RosNode("/a", ["/x"], ["/y"], ["/s"]), RosNode("/b", ["/x"])]))
    first = offers.graph_update(before, {})
    assert first["publishedTopics"] == [{"name": "/x", "publisherIds": ["/a", "/b"]}]
    assert first["advertisedServices"] == [{"name": "/s", "providerIds": ["/a"]}]
    after = offers.connections(RosGraph([], [], [], [RosNode("/b", ["/z"], ["/x"])]))
    second = offers.graph_update(after, before)
    assert second["removedTopics"] == ["/y"]
    assert second["removedServices"] == ["/s"]
    assert {"name": "/x", "publisherIds": []} in second["publishedTopics"]  # type: ignore[operator]
    assert not any(offers.graph_update(after, after).values())


async def test_type_that_could_not_be_described_is_asked_for_again(
    guest: FakeGuest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(offers, "RETRY", 0.0)
    topics, definitions = Offers(guest.as_guest(), "msg"), guest.definitions

    async def away(type: str, sort: Sort) -> dict[str, Definition]:
        raise Unavailable("the Master is away")

    monkeypatch.setattr(guest, "definitions", away)
    assert not (await topics.update(RosGraph([CHAT], []))).added
    monkeypatch.setattr(guest, "definitions", definitions)
    assert len((await topics.update(RosGraph([CHAT], []))).added) == 1

"""Topics between a robot and a real node."""

from __future__ import annotations

import asyncio

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from environment_driver import FakeMaster
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String

from rce.calls.endpoints import NodeSpec, StartNode, StopNode, Unbind
from rce.calls.robots import Describe
from rce.calls.watching import ReadGraph, RosName
from rce.errors import InvalidRequest, UnknownType
from rce.messages import Qos


def cdr(text: str) -> bytes:
    return serialize_message(String(data=text))


def text(payload: bytes) -> str:
    found: str = deserialize_message(payload, String).data
    return found


async def test_there_and_back(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    back = await master.interface("SubscriberInterface", "std_msgs/msg/String", "/back")
    for number in range(20):
        there.publish(cdr(f"hello {number}"))
        assert text(await back.next()) == f"hello {number}"


async def test_what_comes_before_a_subscription_waits_for_it(master: FakeMaster) -> None:
    early = await master.interface("PublisherInterface", "std_msgs/String", "early/there", Qos(depth=2))
    late = await master.bind("SubscriberInterface", "std_msgs/String", "early/back")
    heard = await master.connect(late)
    for word in ("one", "two", "three"):
        early.publish(cdr(word))
    await master.call(StartNode(NodeSpec("early", "probe", "echo.py", namespace="early")))
    assert [text(await heard.next()), text(await heard.next())] == ["two", "three"]
    report = await master.report(early.spec.tag)
    assert report.drops == 1
    await master.call(StopNode("early"))


async def test_every_peer_hears_and_latched_topics_reach_late_ones(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "latched")
    first = await master.connect(bound)
    assert text(await first.next()) == "kept"
    second = await master.connect(bound)
    assert text(await second.next()) == "kept"
    assert first.got.empty()


async def test_a_latched_topic_is_followed_when_its_publisher_comes_later(master: FakeMaster) -> None:
    heard = await master.interface("SubscriberInterface", "std_msgs/String", "/later/latched")
    await master.call(StartNode(NodeSpec("later", "probe", "echo.py", namespace="/later")))
    assert text(await heard.next()) == "kept"
    await master.call(StopNode("later"))


async def test_late_peers_hear_a_latched_topic_that_is_younger_than_the_interface(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "/younger/latched")
    first = await master.connect(bound)
    await master.call(StartNode(NodeSpec("younger", "probe", "echo.py", "once_heard", namespace="/younger")))
    assert text(await first.next()) == "kept"
    second = await master.connect(bound)
    assert text(await second.next()) == "kept"
    assert first.got.empty()
    await master.call(StopNode("younger"))


async def test_nobody_hears_himself(master: FakeMaster) -> None:
    said = await master.interface("PublisherInterface", "std_msgs/String", "back")
    heard = await master.interface("SubscriberInterface", "std_msgs/String", "back")
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    said.publish(cdr("to myself"))
    there.publish(cdr("to the node"))
    assert text(await heard.next()) == "to the node"


async def test_qos_follows_best_effort_nodes(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "/best/there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "/best/back")
    await master.call(StartNode(NodeSpec("best", "probe", "echo.py", "best_effort", namespace="best")))
    async with asyncio.timeout(10):
        while back.got.empty():  # best effort also means that the first may be lost
            there.publish(cdr("effort"))
            await asyncio.sleep(0.05)
    await master.call(StopNode("best"))


async def test_qos_that_does_not_match_is_reported_with_both_sides(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "back", Qos(durability="transient_local"))
    report = await master.report(bound.tag)
    assert report.error is not None
    assert "publisher is reliable, volatile, the subscription reliable, transient_local" in report.error.message


async def test_keep_all_loses_nothing(master: FakeMaster) -> None:
    keep = Qos(history="keep_all")
    there = await master.interface("PublisherInterface", "std_msgs/String", "/keep/there", keep)
    back = await master.interface("SubscriberInterface", "std_msgs/String", "/keep/back", keep)
    await master.call(StartNode(NodeSpec("keep", "probe", "echo.py", "keep_all", namespace="keep")))
    for number in range(500):
        while (room := there.room()) is not None:
            await room
        there.publish(cdr(str(number)))
    assert [text(await back.next()) for _ in range(500)] == [str(number) for number in range(500)]
    await master.call(StopNode("keep"))


async def test_large_messages(master: FakeMaster) -> None:
    said = await master.bind("PublisherInterface", "sensor_msgs/Image", "image")
    there = await master.connect(said)
    back = await master.interface("SubscriberInterface", "sensor_msgs/Image", "image_back")
    await master.call(StartNode(NodeSpec("large", "probe", "images.py")))
    sent = Image(width=2000, height=1000, data=bytes(range(250)) * 24_000)
    there.publish(serialize_message(sent))
    same = deserialize_message(await back.next(), Image) == sent  # not their bytes: ROS leaves what it finds in padding
    assert same, "pytest would compare millions of numbers one by one"
    await master.call(StopNode("large"))


async def test_what_is_not_cdr_is_reported(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    there.publish(b"nonsense")
    report = await master.report(there.spec.tag)
    assert report.error is not None
    assert report.error.code == "conversion"


@pytest.mark.parametrize("addr", ["", "a b", "1a", "/a//b", "a/"])
async def test_names_that_ros_does_not_take(master: FakeMaster, addr: str) -> None:
    with pytest.raises(InvalidRequest, match="addr"):
        await master.bind("SubscriberInterface", "std_msgs/String", addr)


@pytest.mark.parametrize("name", ["std_msgs/Strong", "none_msgs/String", "os/path", "std_srvs/SetBool"])
async def test_unknown_types(master: FakeMaster, name: str) -> None:
    with pytest.raises(UnknownType):
        await master.bind("PublisherInterface", name, "a")


async def test_describe(master: FakeMaster) -> None:
    described = await master.call(Describe("user", "sensor_msgs/Image", service=False))
    assert {"sensor_msgs/msg/Image", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"} == set(described.texts)


async def test_what_ros_has_is_read(master: FakeMaster) -> None:
    await master.interface("SubscriberInterface", "std_msgs/String", "/read/here")
    await master.interface("ServiceProviderInterface", "std_srvs/SetBool", "/read/asked")
    graph = await master.call(ReadGraph())
    (topic,) = [each for each in graph.topics if each.name == "/read/here"]
    assert (topic.types, topic.publishers, topic.subscribers) == (["std_msgs/msg/String"], 0, 1)
    assert RosName("/read/asked", ["std_srvs/srv/SetBool"]) in graph.services


async def test_unbound_interfaces_are_gone(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "back")
    heard = await master.connect(bound)
    await master.call(Unbind(bound.id))
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "back")
    there.publish(cdr("x"))
    await back.next()
    await asyncio.sleep(0)
    assert heard.got.empty()

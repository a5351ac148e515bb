"""Topic interfaces between a robot and a real node."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Literal, cast
from unittest.mock import Mock

import msgspec
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import String

from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext
from endpoints.environment.topics import NODE_START, PublisherInterface, SubscriberInterface
from rce.control.calls.endpoints import InterfaceSpec, NodeSpec, Report, StartNode, StopNode, Unbind
from rce.control.calls.watching import CountTraffic
from rce.errors import InvalidRequest, LimitExceeded, RceError, UnknownType
from rce.net.budget import INTERFACE
from rce.protocol.messages import Qos
from rce.protocol.messages.commands import SHALLOW
from tests.support.endpoints.environment_driver import LIMIT, FakeMaster, Robot, wait_for_line


def cdr(text: str) -> bytes:
    return serialize_message(String(data=text))


def text(payload: bytes) -> str:
    found: str = deserialize_message(payload, String).data
    return found


async def wait_for_echo(there: Robot, back: Robot, *others: Robot) -> None:
    """Send until a message comes back: the node may not have discovered the subscription when it gets the first.

    Then nothing is on its way any more, neither to `back` nor to other robots that get what `there` sends.
    """
    async with asyncio.timeout(LIMIT):
        while back.received.empty():
            there.publish(cdr("ready"))
            await asyncio.sleep(0.1)
        there.publish(cdr("the last"))
        for robot in (back, *others):
            while text(await robot.next()) != "the last":
                pass


async def test_messages_pass_to_node_and_back(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    back = await master.interface("SubscriberInterface", "std_msgs/msg/String", "/back")
    await wait_for_echo(there, back)
    for number in range(20):
        there.publish(cdr(f"hello {number}"))
        assert text(await back.next()) == f"hello {number}"


async def test_robots_receive_what_other_robots_publish_on_the_topic(master: FakeMaster) -> None:
    one = await master.interface("PublisherInterface", "std_msgs/String", "shared")
    two = await master.interface("SubscriberInterface", "std_msgs/msg/String", "/shared")
    elsewhere = await master.interface("SubscriberInterface", "std_msgs/String", "elsewhere")
    for number in range(20):
        one.publish(cdr(f"hello {number}"))
        assert text(await two.next()) == f"hello {number}"
    assert elsewhere.received.empty()


async def test_node_and_robot_receive_a_message_once(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "back")
    aside = await master.interface("SubscriberInterface", "std_msgs/String", "there")
    await wait_for_echo(there, back, aside)
    for number in range(10):
        there.publish(cdr(f"once {number}"))
    for number in range(10):
        assert text(await aside.next()) == f"once {number}"
        assert text(await back.next()) == f"once {number}"
    assert aside.received.empty()


async def test_late_robot_gets_last_message_of_a_latched_robot(master: FakeMaster) -> None:
    latched = Qos(durability="transient_local", reliability="reliable", depth=1)
    there = await master.interface("PublisherInterface", "std_msgs/String", "kept", latched)
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "kept", latched)
    first = await master.connect(bound)
    for word in ("one", "two"):
        there.publish(cdr(word))
        assert text(await first.next()) == word
    late = await master.connect(bound)
    assert text(await late.next()) == "two"


async def test_messages_wait_for_first_subscription(master: FakeMaster) -> None:
    early = await master.interface("PublisherInterface", "std_msgs/String", "early/there", Qos(depth=2))
    late = await master.bind("SubscriberInterface", "std_msgs/String", "early/back")
    receiver = await master.connect(late)
    for word in ("one", "two", "three"):
        early.publish(cdr(word))
    await master.call(StartNode(NodeSpec("early", "probe", "echo.py", namespace="early")))
    assert [text(await receiver.next()), text(await receiver.next())] == ["two", "three"]
    await master.call(StopNode("early"))


async def test_node_that_starts_later_gets_last_message(master: FakeMaster) -> None:
    place = "restarted"
    there = await master.interface("PublisherInterface", "std_msgs/String", f"{place}/there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", f"{place}/back")
    for word in ("one", "two"):
        there.publish(cdr(word))
    await master.call(StartNode(NodeSpec(place, "probe", "echo.py", namespace=place)))
    assert [text(await back.next()), text(await back.next())] == ["one", "two"]
    await master.call(StopNode(place))
    await master.call(StartNode(NodeSpec(place, "probe", "echo.py", namespace=place)))
    assert text(await back.next()) == "two"
    await master.call(StopNode(place))


async def test_message_of_an_interface_that_is_removed_at_once_arrives(master: FakeMaster) -> None:
    """A client may connect, publish and leave."""
    back = await master.interface("SubscriberInterface", "std_msgs/String", "once/back")
    await master.call(StartNode(NodeSpec("once", "probe", "echo.py", namespace="once")))
    await wait_for_line(master, "once", "words is")
    for number in range(5):
        spec = await master.bind("PublisherInterface", "std_msgs/String", "once/there")
        robot = await master.connect(spec)
        robot.publish(cdr(str(number)))
        async with asyncio.timeout(LIMIT):
            while not (await master.call(CountTraffic())).interfaces[spec.id].received.messages:  # noqa: ASYNC110
                await asyncio.sleep(0.001)
        await master.call(Unbind(spec.id))
        assert text(await back.next()) == str(number)
    await master.call(StopNode("once"))


async def test_later_node_that_asks_for_last_message_gets_it(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "asking/there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "asking/back")
    await master.call(StartNode(NodeSpec("plain", "probe", "echo.py", namespace="asking")))
    there.publish(cdr("one"))
    assert text(await back.next()) == "one"
    await master.call(StartNode(NodeSpec("asking", "probe", "echo.py", "latched", namespace="asking")))
    assert text(await back.next()) == "one"
    for tag in ("plain", "asking"):
        await master.call(StopNode(tag))


async def test_last_message_is_not_repeated_to_a_node_that_got_it(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "twice/there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "twice/back")
    await master.call(StartNode(NodeSpec("first", "probe", "echo.py", namespace="twice")))
    there.publish(cdr("one"))
    assert text(await back.next()) == "one"
    await master.call(StartNode(NodeSpec("second", "probe", "echo.py", namespace="twice")))
    await wait_for_line(master, "second", "words is")
    got: list[str] = []
    async with asyncio.timeout(LIMIT):
        while got[-2:] != ["two", "two"]:  # of both nodes; the second may not have discovered the publisher at first
            there.publish(cdr("two"))
            while not got or not back.received.empty():
                got.append(text(await back.next()))
            await asyncio.sleep(0.05)
    assert set(got) == {"two"}
    for tag in ("first", "second"):
        await master.call(StopNode(tag))


async def test_all_peers_get_messages_and_late_ones_those_of_latched_topics(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "latched")
    first = await master.connect(bound)
    assert text(await first.next()) == "kept"
    second = await master.connect(bound)
    assert text(await second.next()) == "kept"
    assert first.received.empty()


async def test_latched_publisher_that_comes_after_interface(master: FakeMaster) -> None:
    receiver = await master.interface("SubscriberInterface", "std_msgs/String", "/later/latched")
    await master.call(StartNode(NodeSpec("later", "probe", "echo.py", namespace="/later")))
    assert text(await receiver.next()) == "kept"
    await master.call(StopNode("later"))


async def test_late_peer_gets_message_of_latched_publisher_that_came_after_interface(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "/younger/latched")
    first = await master.connect(bound)
    await master.call(StartNode(NodeSpec("younger", "probe", "echo.py", "once_subscribed", namespace="/younger")))
    assert text(await first.next()) == "kept"
    second = await master.connect(bound)
    assert text(await second.next()) == "kept"
    assert first.received.empty()
    await master.call(StopNode("younger"))


async def test_qos_adapts_to_best_effort_nodes(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "/best/there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "/best/back")
    await master.call(StartNode(NodeSpec("best", "probe", "echo.py", "best_effort", namespace="best")))
    async with asyncio.timeout(LIMIT):
        while back.received.empty():  # the first messages may be lost
            there.publish(cdr("effort"))
            await asyncio.sleep(0.05)
    await master.call(StopNode("best"))


async def test_incompatible_qos_is_reported(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "back", Qos(durability="transient_local"))
    report = await master.report(bound.tag)
    assert report.error is not None
    assert "publisher is reliable, volatile, the subscription reliable, transient_local" in report.error.message


async def test_keep_all_drops_nothing(master: FakeMaster) -> None:
    keep = Qos(history="keep_all")
    there = await master.interface("PublisherInterface", "std_msgs/String", "/keep/there", keep)
    back = await master.interface("SubscriberInterface", "std_msgs/String", "/keep/back", keep)
    await master.call(StartNode(NodeSpec("keep", "probe", "echo.py", "keep_all", namespace="keep")))
    await wait_for_echo(there, back)
    for number in range(500):
        while (room := there.wait_for_room()) is not None:
            await room
        there.publish(cdr(str(number)))
    received: list[str] = []
    while len(received) < 500:
        received.append(text(await back.next()))
    assert received == [str(number) for number in range(500)]
    await master.call(StopNode("keep"))


@pytest.mark.parametrize(("count", "size"), [(2000, 100), (100, 100_000)])
async def test_messages_of_a_burst_are_all_there_or_counted(master: FakeMaster, count: int, size: int) -> None:
    name = f"burst{size}"
    bound = [
        await master.bind(kind, "std_msgs/String", f"/{name}/{topic}")
        for kind, topic in (("PublisherInterface", "there"), ("SubscriberInterface", "back"))
    ]
    there, back = [await master.connect(each) for each in bound]
    await master.call(StartNode(NodeSpec(name, "probe", "echo.py", "deep", namespace=name)))
    await wait_for_echo(there, back)
    for number in range(count):
        there.publish(cdr(f"{number} {'x' * size}"))
        if number % 50 == 0:
            await asyncio.sleep(0)
    received: list[int] = []
    while not received or received[-1] < count - 1:
        received.append(int(text(await back.next()).split()[0]))
    assert received == sorted(set(received))
    drops = dict.fromkeys((each.tag for each in bound), 0)
    while len(received) + there.dropped + sum(drops.values()) < count:
        async with asyncio.timeout(LIMIT):
            report = await master.reports.get()
        if isinstance(report, Report) and report.interface in drops:
            drops[report.interface] = report.drops
    assert len(received) + there.dropped + sum(drops.values()) == count
    assert len(received) >= min(count, 1000), "as many as wait by default"
    await master.call(StopNode(name))


async def test_large_messages(master: FakeMaster) -> None:
    sender = await master.bind("PublisherInterface", "sensor_msgs/Image", "image")
    there = await master.connect(sender)
    back = await master.interface("SubscriberInterface", "sensor_msgs/Image", "image_back")
    await master.call(StartNode(NodeSpec("large", "probe", "images.py")))
    sent = Image(width=2000, height=1000, data=bytes(range(250)) * 24_000)
    there.publish(serialize_message(sent))
    same = deserialize_message(await back.next(), Image) == sent  # not their bytes, because padding is not initialized
    assert same, "a bool, because pytest would print millions of numbers"
    await master.call(StopNode("large"))


async def test_payload_that_is_not_cdr_is_reported(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    there.publish(b"nonsense")
    report = await master.report(there.spec.tag)
    assert report.error is not None
    assert report.error.code == "conversion"


@pytest.mark.parametrize("addr", ["", "a b", "1a", "/a//b", "a/"])
async def test_invalid_ros_names_are_rejected(master: FakeMaster, addr: str) -> None:
    with pytest.raises(InvalidRequest, match="addr"):
        await master.bind("SubscriberInterface", "std_msgs/String", addr)


@pytest.mark.parametrize("name", ["std_msgs/Strong", "none_msgs/String", "os/path", "std_srvs/SetBool"])
async def test_unknown_types_are_rejected(master: FakeMaster, name: str) -> None:
    with pytest.raises(UnknownType):
        await master.bind("PublisherInterface", name, "a")


async def test_unbound_interface_receives_nothing(master: FakeMaster) -> None:
    bound = await master.bind("SubscriberInterface", "std_msgs/String", "back")
    receiver = await master.connect(bound)
    await master.call(Unbind(bound.id))
    there = await master.interface("PublisherInterface", "std_msgs/String", "there")
    back = await master.interface("SubscriberInterface", "std_msgs/String", "back")
    await wait_for_echo(there, back)
    assert receiver.received.empty()


async def test_error_of_a_message_that_did_not_reach_its_robot_is_reported() -> None:
    reports: list[RceError] = []
    context = Mock(hops=HopRecorder(), budget=None, report=lambda _, error: reports.append(error))
    spec = InterfaceSpec("ab" * 16, "user/env", "tag", "SubscriberInterface", "std_msgs/String", "addr", Qos())
    interface = SubscriberInterface(spec, context)
    undelivered = msgspec.msgpack.encode(LimitExceeded("too large for the robot").info)
    interface.receive(Message(bytes(16), "", undelivered, error=True), cast(Link, None))
    assert str(reports[-1]) == "too large for the robot"


def interface_without_node(kind: str, qos: Qos) -> InterfaceSpec:
    return InterfaceSpec("ab" * 16, "user/env", "tag", kind, "std_msgs/String", "addr", qos)


@pytest.mark.parametrize("history", ["keep_last", "keep_all"])
async def test_messages_for_a_busy_node_are_bounded_by_bytes(history: Literal["keep_last", "keep_all"]) -> None:
    spec = interface_without_node("PublisherInterface", Qos(history=history, depth=1000))
    interface = PublisherInterface(spec, Mock(hops=HopRecorder(), budget=None))
    interface._publisher = Mock(waiting=deque())
    link = Mock()
    large = bytes(2) + bytes(INTERFACE // 4)
    for _ in range(3):
        interface.receive(Message(bytes(16), "", large), link)
    assert (interface.dropped, link.pause.called) == (0, False)
    for _ in range(2):
        interface.receive(Message(bytes(16), "", large), link)
    if history == "keep_all":
        assert (interface.dropped, link.pause.called) == (0, True)
    else:
        assert (interface.dropped, len(interface._publisher.waiting)) == (2, 3)
    interface.close()


@pytest.mark.parametrize("robots_subscribe", [False, True])
async def test_burst_waits_for_a_node_that_is_starting_but_not_for_ever(robots_subscribe: bool) -> None:
    spec = interface_without_node("PublisherInterface", Qos())
    interface = PublisherInterface(spec, Mock(hops=HopRecorder(), budget=None))
    interface._context.shared.has_receivers.return_value = robots_subscribe  # type: ignore[attr-defined]
    interface._publisher = Mock(waiting=deque(), has_subscription=False)
    link = Mock()
    waiting = interface._publisher.waiting
    for number in range(500):
        interface.receive(Message(bytes(16), "", cdr(str(number))), link)
    for _ in range(NODE_START):
        interface.tick(0.0)
    assert len(waiting) == 500
    interface.receive(Message(bytes(16), "", cdr("500")), link)
    interface.tick(0.0)
    assert [text(payload) for payload in waiting] == [str(number) for number in range(501 - SHALLOW, 501)]
    assert interface.dropped == 0
    assert interface.counted.unheard == (0 if robots_subscribe else 501 - SHALLOW)


async def test_messages_beyond_the_depth_are_unheard_while_no_node_subscribes_and_dropped_afterwards() -> None:
    interface = PublisherInterface(
        interface_without_node("PublisherInterface", Qos(depth=2)),
        RosContext(Mock(), HopRecorder(), Mock(), Mock()),
    )
    interface._publisher = Mock(waiting=deque(), has_subscription=False)
    for has_subscription in (False, True):
        interface._publisher.has_subscription = has_subscription  # type: ignore[misc]
        for word in ("one", "two", "three"):
            interface.receive(Message(bytes(16), "", cdr(word)), Mock())
    assert (interface.unheard, interface.dropped) == (1, 3)

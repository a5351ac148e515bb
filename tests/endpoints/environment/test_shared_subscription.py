"""Subscriptions that interfaces of an environment share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, cast
from unittest.mock import Mock

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.data import frames
from endpoints.data.frames import MAX_SENDERS, Message
from endpoints.data.hops import HopRecorder
from endpoints.data.link import Link
from endpoints.environment import shared_subscription
from endpoints.environment.ros import Ros
from endpoints.environment.ros_topics import RawSubscription
from endpoints.environment.shared_subscription import SharedSubscription, SharedSubscriptions
from endpoints.environment.shared_topics import SharedTopics
from endpoints.environment.topics import SubscriberInterface
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, RceError
from rce.net.budget import INTERFACE, MB, Budget
from rce.protocol.messages import Qos
from tests.support.endpoints.environment_driver import FakeMaster
from tests.support.endpoints.fake_ros import InstantRos

STRING = "std_msgs/String"


class Line:
    """Link that records what is sent, and drops as many messages as the test says."""

    to_environment = False

    def __init__(self, drops: int = 0) -> None:
        self.sent: list[Message] = []
        self.drops = drops
        self.discarded: list[bytes] = []
        self.gathering = False
        self.together: list[int] = []
        self.room: asyncio.Future[None] | None = None

    def send(self, message: Message, keep: int | None, owner: object) -> int:
        self.sent.append(message)
        if self.gathering:
            self.together[-1] += 1
        return self.drops

    def wait_for_room(self, source: bytes) -> asyncio.Future[None] | None:
        return self.room

    def gather(self) -> None:
        self.gathering = True
        self.together.append(0)

    def flush(self) -> None:
        self.gathering = False

    def discard(self, source: bytes) -> None:
        self.discarded.append(source)


class Bench:
    """Interfaces that share subscriptions of a fake ROS."""

    def __init__(self) -> None:
        self.ros = InstantRos()
        self.reports: list[RceError] = []
        self.subscriptions = SharedSubscriptions(cast(Ros, self.ros), SharedTopics(), Budget(100 * MB))
        self.entities: list[Mock] = []
        report: Callable[[InterfaceSpec, RceError], None] = lambda _, error: self.reports.append(error)  # noqa: E731
        self.context = Mock(hops=HopRecorder(), budget=None, subscriptions=self.subscriptions, report=report)

    def create(self, _: Callable[[], RawSubscription]) -> RawSubscription:
        self.entities.append(Mock(latched=False, had_publishers=False))
        return cast(RawSubscription, self.entities[-1])

    async def interface(self, number: int, qos: Qos = Qos(), addr: str = "a") -> SubscriberInterface:  # noqa: B008
        spec = InterfaceSpec(f"{number:032x}", "u/e", f"i{number}", "SubscriberInterface", STRING, addr, qos)
        made = SubscriberInterface(spec, self.context)
        made._subscription = await self.subscriptions.join(made, made.qos, made.keep, Mock, self.create)
        return made


def connect(interface: SubscriberInterface, peer: int, line: Line) -> None:
    interface.peers[bytes([peer]) * 16] = cast(Link, line)
    interface.joined(bytes([peer]) * 16)


def publish(shared: SharedSubscription, payload: bytes, publisher: bytes = b"p") -> None:
    shared._take([(payload, publisher)])


async def test_messages_stay_in_ros_until_the_links_have_room_if_none_may_be_dropped() -> None:
    bench, line = Bench(), Line()
    interface = await bench.interface(1, Qos(history="keep_all"))
    connect(interface, 1, line)
    (entity,), shared = bench.entities, interface._subscription
    assert shared._take([(b"x", b"p")])
    line.room = full = asyncio.get_running_loop().create_future()
    assert not shared._take([(b"y", b"p")])
    line.room = still_full = asyncio.get_running_loop().create_future()
    full.set_result(None)
    await asyncio.sleep(0)
    entity.resume.assert_not_called()
    line.room = None
    still_full.set_result(None)
    await asyncio.sleep(0)
    entity.resume.assert_called_once()
    assert [each.payload for each in line.sent] == [b"x", b"y"]


async def test_messages_that_came_together_go_out_together() -> None:
    bench, line = Bench(), Line()
    interface = await bench.interface(1)
    connect(interface, 1, line)
    interface._subscription._take([(b"x", b"p"), (b"y", b"p"), (b"z", b"p")])
    publish(interface._subscription, b"alone")
    assert [each.payload for each in line.sent] == [b"x", b"y", b"z", b"alone"]
    assert line.together == [3]
    assert not line.gathering


async def test_link_is_flushed_after_a_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    bench, line = Bench(), Line()
    interface = await bench.interface(1)
    connect(interface, 1, line)
    monkeypatch.setattr(line, "send", Mock(side_effect=ZeroDivisionError))
    with pytest.raises(ZeroDivisionError):
        interface._subscription._take([(b"x", b"p"), (b"y", b"p")])
    assert not line.gathering


async def test_message_goes_once_to_each_link_with_all_senders_behind_it() -> None:
    bench, near, far = Bench(), Line(), Line()
    interfaces = [await bench.interface(number) for number in range(50)]
    assert len(bench.entities) == 1
    for number, each in enumerate(interfaces):
        connect(each, number, far if number == 49 else near)
    publish(interfaces[0]._subscription, b"x")
    assert [len(line.sent) for line in (near, far)] == [1, 1]
    assert near.sent[0].senders == tuple(each.id for each in interfaces[:49])
    assert near.sent[0].source == far.sent[0].source == interfaces[0].queue
    assert {each.traffic.sent.messages for each in interfaces} == {1}


async def test_interfaces_beyond_one_message_get_another() -> None:
    bench, line = Bench(), Line()
    interfaces = [await bench.interface(number) for number in range(MAX_SENDERS + 1)]
    for each in interfaces:
        connect(each, 1, line)
    publish(interfaces[0]._subscription, b"x")
    assert [len(each.senders) for each in line.sent] == [MAX_SENDERS, 1]


async def test_other_topics_and_quality_of_service_have_subscriptions_of_their_own() -> None:
    bench = Bench()
    for number, (qos, addr) in enumerate([(Qos(), "a"), (Qos(), "/a"), (Qos(), "b"), (Qos(depth=3), "a")]):
        await bench.interface(number, qos, addr)
    assert len(bench.entities) == 3
    for number in (10, 11):
        await bench.interface(number, Qos(history="keep_all"))
    assert len(bench.entities) == 5, "each waits for its own slowest link"


async def test_subscription_runs_while_a_member_has_a_peer_and_ends_with_the_last_member() -> None:
    bench, line = Bench(), Line()
    one, other = [await bench.interface(number) for number in range(2)]
    (entity,) = bench.entities
    connect(one, 1, line)
    connect(other, 2, line)
    entity.start.assert_called_once()
    one.peers.clear()
    one.unlinked(cast(Link, line))
    entity.pause.assert_not_called()
    assert line.discarded == []
    one.close()
    other.peers.clear()
    other.unlinked(cast(Link, line))
    entity.pause.assert_called_once()
    assert line.discarded == [other.queue]
    other.close()
    other.close()
    await bench.interface(3)
    assert len(bench.entities) == 2


async def test_drops_are_counted_for_the_interfaces_behind_the_link() -> None:
    bench, full, free = Bench(), Line(drops=2), Line()
    one, other = [await bench.interface(number) for number in range(2)]
    connect(one, 1, full)
    connect(other, 2, free)
    publish(one._subscription, b"x")
    assert (one.dropped, other.dropped) == (2, 0)
    one._subscription.evicted(3)
    assert (one.dropped, other.dropped) == (5, 3)


async def test_message_too_large_for_links_is_reported_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames, "MAX_MESSAGE", 1000)
    bench, line = Bench(), Line()
    interface = await bench.interface(1)
    connect(interface, 1, line)
    for size in (1001, 1001, 10):
        publish(interface._subscription, bytes(size))
    assert (interface.dropped, len(line.sent)) == (2, 1)
    assert [error.code for error in bench.reports] == ["limit_exceeded"]


async def test_late_peer_gets_the_kept_messages_of_latched_publishers() -> None:
    bench, line = Bench(), Line()
    first, late = [await bench.interface(number) for number in range(2)]
    bench.entities[0].latched = True
    connect(first, 1, line)
    publish(first._subscription, b"one")
    publish(first._subscription, b"two")
    connect(late, 2, line)
    assert (line.sent[-1].payload, line.sent[-1].destination) == (b"two", bytes([2]) * 16)
    assert line.sent[-1].senders == (late.id,)
    assert len(line.sent) == 3


async def test_messages_kept_for_late_peers_are_bounded_by_bytes() -> None:
    bench = Bench()
    interface = await bench.interface(1, Qos(durability="transient_local", depth=1000))
    bench.entities[0].latched = True
    shared = interface._subscription
    publish(shared, b"first", b"other")
    for number in range(10):
        publish(shared, bytes([number]) * (INTERFACE // 4))
    assert [payload[0] for messages in shared._latched.values() for payload in messages] == [6, 7, 8, 9]
    publish(shared, bytes(2 * INTERFACE))
    assert [len(payload) for messages in shared._latched.values() for payload in messages] == [2 * INTERFACE]


async def test_mismatch_is_reported_to_members_that_come_later_too() -> None:
    bench = Bench()
    first = await bench.interface(1)
    first._subscription._mismatch("the publisher is volatile")
    await bench.interface(2)
    assert [str(error) for error in bench.reports] == [f"interface i{n}: the publisher is volatile" for n in (1, 2)]


async def test_every_member_waits_until_the_publishers_have_discovered_the_subscription(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    discovered: list[Callable[[], None]] = []
    monkeypatch.setattr(shared_subscription, "after_discovery", lambda ros, peers, action: discovered.append(action))
    bench = Bench()

    def create(_: Callable[[], RawSubscription]) -> RawSubscription:
        return cast(RawSubscription, Mock(latched=False, had_publishers=True))

    monkeypatch.setattr(bench, "create", create)
    first = asyncio.create_task(bench.interface(1))
    second = asyncio.create_task(bench.interface(2))
    done, _ = await asyncio.wait({first, second}, timeout=0.1)
    assert not done
    first.cancel()
    (found,) = discovered
    found()
    await asyncio.wait({first, second})
    assert second.result()
    await bench.interface(3)


async def test_subscription_that_ros_refuses_fails_for_all_who_wait_and_is_tried_again() -> None:
    bench = Bench()
    accept = bench.create

    def refuse(_: Any) -> RawSubscription:
        raise InvalidRequest("no such name")

    bench.create = refuse  # type: ignore[method-assign]
    joins = [asyncio.create_task(bench.interface(number)) for number in range(2)]
    assert [str(each) for each in await asyncio.gather(*joins, return_exceptions=True)] == ["no such name"] * 2
    bench.create = accept  # type: ignore[method-assign]
    await bench.interface(3)
    assert len(bench.entities) == 1


async def test_what_came_from_an_environment_goes_to_robots_only() -> None:
    bench, robot, environment = Bench(), Line(), Line()
    environment.to_environment = True
    interface = await bench.interface(1)
    connect(interface, 1, robot)
    connect(interface, 2, environment)
    interface._subscription.receive_shared(Message(bytes(16), "", b"x"), cast(Link, environment), False)
    assert (len(robot.sent), len(environment.sent)) == (1, 0)


async def test_message_reaches_the_robots_of_all_members(master: FakeMaster) -> None:
    there = await master.interface("PublisherInterface", STRING, "once")
    both = [await master.interface("SubscriberInterface", STRING, "once") for _ in range(2)]
    there.publish(b"\0\1\0\0\2\0\0\0x\0")
    assert [bytes(await each.next()) for each in both] == [b"\0\1\0\0\2\0\0\0x\0"] * 2

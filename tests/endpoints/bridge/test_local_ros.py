"""Interfaces in the robot's own ROS, with a fake of the ROS node."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import cast

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from endpoints.bridge.local_ros import CLOUD, CloudLink, LocalRos
from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.ros import Ros
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, UnknownType
from rce.net.outbox import Owner
from rce.protocol.messages import Qos
from tests.support.hand_turned import HandTurnedLoop


class Recorder(RosInterface):
    """Interface that records what happens to it; ROS rejects the address `bad`."""

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context)
        self.events: list[str] = []
        self.ticks: list[float] = []

    async def open(self) -> None:
        if self.spec.addr == "bad":
            raise InvalidRequest("ROS rejects it")
        self.events.append("opened")

    def receive(self, message: Message, link: Link) -> None:
        self.events.append("received")

    def joined(self, peer: bytes) -> None:
        self.events.append("joined by cloud" if peer == CLOUD else f"joined by {peer!r}")

    def started(self) -> None:
        self.events.append("started")

    def stopped(self) -> None:
        self.events.append("stopped")

    def close(self) -> None:
        self.events.append("closed")

    def tick(self, now: float) -> None:
        self.ticks.append(now)


class DroppingLink(CloudLink):
    """Link that records messages, and drops one for each."""

    def __init__(self) -> None:
        super().__init__()
        self.sent: list[Message] = []

    def send(self, message: Message, keep: int | None, owner: Owner | None = None) -> int:
        self.sent.append(message)
        return 1


@pytest.fixture
async def local() -> AsyncIterator[LocalRos]:
    made = LocalRos(cast(Ros, None), [])
    yield made
    made.close()


def totals(local: LocalRos) -> dict[tuple[str, ...], float]:
    """Return the metrics by name and labels."""
    return {(family.name, *sample.labels): sample.value for family in local.families() for sample in family.samples}


async def test_interface_is_connected_to_its_link(local: LocalRos) -> None:
    link = DroppingLink()
    made = await local.add_interface(Recorder, "a/B", "/scan", link, Qos(depth=3))
    assert isinstance(made, Recorder)
    assert made.events == ["opened", "joined by cloud", "started"]
    assert (made.spec.type, made.spec.addr, made.spec.qos) == ("a/B", "/scan", Qos(depth=3))
    made.send(Message(made.id, "1", b"abc"))
    assert [message.msg_id for message in link.sent] == ["1"]
    assert (made.traffic.of(CLOUD).drops, made.dropped) == (1, 1)


async def test_interface_that_ros_rejects_is_not_added(local: LocalRos) -> None:
    with pytest.raises(InvalidRequest):
        await local.add_interface(Recorder, "a/B", "bad", DroppingLink())
    local.close()  # has nothing to remove
    assert totals(local)["rce_messages", "sent"] == 0


async def test_removed_interface_is_closed_and_stays_counted(local: LocalRos) -> None:
    made = await local.add_interface(Recorder, "a/B", "/scan", DroppingLink())
    assert isinstance(made, Recorder)
    made.send(Message(made.id, "1", b"abc"))
    local.remove_interface(made)
    assert (made.events[-2:], made.peers) == (["stopped", "closed"], {})
    other = await local.add_interface(Recorder, "a/B", "/other", DroppingLink())
    other.send(Message(other.id, "1", b"12345"))
    found = totals(local)
    assert (found["rce_messages", "sent"], found["rce_bytes", "sent"], found["rce_drops",]) == (2, 8, 2)


async def test_close_removes_all_interfaces(local: LocalRos) -> None:
    made = [await local.add_interface(Recorder, "a/B", name, DroppingLink()) for name in ("/a", "/b")]
    local.close()
    assert [cast(Recorder, each).events[-1] for each in made] == ["closed", "closed"]


async def test_unknown_type_has_no_definition(local: LocalRos) -> None:
    with pytest.raises(UnknownType):
        local.describe("none_msgs/Nothing")


async def test_link_always_has_room() -> None:
    link = CloudLink()
    assert link.opened.done()
    assert (link.wait_for_room(CLOUD), link.backlog(CLOUD)) == (None, 0)


def test_interfaces_process_timeouts_once_a_second(hand: HandTurnedLoop) -> None:
    local = hand.do(lambda: LocalRos(cast(Ros, None), []))

    async def add() -> RosInterface:
        return await local.add_interface(Recorder, "a/B", "/scan", DroppingLink())

    made = hand.begin(add()).result()
    assert isinstance(made, Recorder)
    hand.turn(3.5)
    assert made.ticks == [1.0, 2.0, 3.0]
    hand.do(local.close)
    hand.turn(2)
    assert len(made.ticks) == 3

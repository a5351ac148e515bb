"""Goals that an environment sends to an action server of rclpy."""

from __future__ import annotations

import asyncio
import select
import threading
import uuid
from collections.abc import AsyncIterator
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
pytest.importorskip("test_msgs", reason="needs ros-test-msgs: pip install '.[dev]'")

from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from test_msgs.action import Fibonacci

from endpoints.data.frames import Phase
from endpoints.environment.action_client import ActionClientInterface
from rce.errors import ConversionError, Lost, NotFound
from tests.support.endpoints.actions import ENDLESS, REJECTED, Peer, Server, interface_of, spinning
from tests.support.endpoints.ros_world import LIMIT, RosWorld


def goal(order: int) -> bytes:
    return bytes(serialize_message(Fibonacci.Goal(order=order)))


def numbers(payload: object, kind: type = Fibonacci.Result) -> list[int]:
    assert isinstance(payload, bytes)
    return list(deserialize_message(payload, kind).sequence)


@pytest.fixture
async def asking(world: RosWorld) -> AsyncIterator[tuple[Peer, Server]]:
    """A peer of an action client interface, and the server."""
    name = f"/fibonacci_{uuid.uuid4().hex[:8]}"
    server = Server(world.other, name)
    interface = await interface_of(ActionClientInterface, world, name, [])
    async with asyncio.timeout(LIMIT):
        while not world.other.count_subscribers(f"{name}/_action/feedback"):  # noqa: ASYNC110
            await asyncio.sleep(0.01)  # feedback is lost before the server has discovered the subscription
    async with spinning(world.other):
        peer = Peer(interface)
        yield peer, server
        interface.close()
        server.destroy()


Asking = tuple[Peer, Server]


async def test_goal_gets_feedback_and_result(asking: Asking) -> None:
    peer, _ = asking
    id = uuid.uuid4().hex
    peer.send(id, Phase.GOAL, goal(3))
    received = [await peer.next() for _ in range(5)]
    assert sorted(message.phase for message in received) == [
        Phase.ACCEPTED,
        *[Phase.FEEDBACK] * 3,
        Phase.SUCCEEDED,
    ]
    feedback = [numbers(each.payload, Fibonacci.Feedback) for each in received if each.phase == Phase.FEEDBACK]
    assert feedback == [[0], [0, 1], [0, 1, 2]]
    ended = next(each for each in received if each.phase == Phase.SUCCEEDED)
    assert numbers(ended.payload) == [0, 1, 2]


class LateServer(Server):
    """Action server that begins a goal when it is told to."""

    def __init__(self, node: Node, action: str) -> None:
        self.begin = threading.Event()
        super().__init__(node, action)

    def _execute(self, goal: Any) -> Any:
        self.begin.wait(LIMIT)
        return super()._execute(goal)


async def test_feedback_that_waits_together_with_the_result_comes_before_it(world: RosWorld) -> None:
    name, count = f"/fibonacci_{uuid.uuid4().hex[:8]}", 40
    server = LateServer(world.other, name)
    interface = await interface_of(ActionClientInterface, world, name, [])
    peer = Peer(interface)

    async with spinning(world.other):
        peer.send(uuid.uuid4().hex, Phase.GOAL, goal(count))
        await peer.until(Phase.ACCEPTED)
        while not interface._get_result._in_flight:  # noqa: ASYNC110
            await asyncio.sleep(0)  # until the result is requested
        server.begin.set()
        result = interface._get_result._client._responses._descriptor
        assert select.select([result], [], [], LIMIT)[0]  # the loop takes nothing meanwhile
        phases = [(await peer.next()).phase for _ in range(count + 1)]
        assert phases == [Phase.FEEDBACK] * count + [Phase.SUCCEEDED]
        interface.close()
        server.destroy()


async def test_rejected_goal_ends(asking: Asking) -> None:
    peer, _ = asking
    peer.send(uuid.uuid4().hex, Phase.GOAL, goal(REJECTED))
    assert (await peer.next()).phase == Phase.REJECTED


@pytest.mark.parametrize("when", ["at once", "accepted"])
async def test_goal_is_canceled(asking: Asking, when: str) -> None:
    peer, _ = asking
    id = uuid.uuid4().hex
    peer.send(id, Phase.GOAL, goal(ENDLESS))
    if when == "accepted":
        await peer.until(Phase.ACCEPTED)
    peer.send(id, Phase.CANCEL)
    await peer.until(Phase.CANCELED)  # before or after the server's answer to the request


async def test_goals_of_a_server_that_is_gone_are_lost(asking: Asking, world: RosWorld) -> None:
    peer, server = asking
    peer.send(uuid.uuid4().hex, Phase.GOAL, goal(ENDLESS))
    await peer.until(Phase.ACCEPTED)
    server.destroy()
    async with asyncio.timeout(LIMIT):
        while peer.received.empty():
            peer.tick()
            await asyncio.sleep(0.05)
    with pytest.raises(Lost, match="the server is gone"):
        await peer.next()


@pytest.mark.slow
async def test_hundred_goals_at_once_all_end(asking: Asking) -> None:
    peer, _ = asking
    sent = {uuid.uuid4().hex: order % 4 + 1 for order in range(100)}
    for id, order in sent.items():
        peer.send(id, Phase.GOAL, goal(order))
    async with asyncio.timeout(200):
        while sent:
            peer.tick()
            await asyncio.sleep(0.05)
            while not peer.received.empty():
                message = await peer.next()
                if message.phase == Phase.SUCCEEDED:
                    assert len(numbers(message.payload)) == sent.pop(message.msg_id)


async def test_leased_goal_is_canceled_when_its_asker_is_gone(asking: Asking) -> None:
    peer, _ = asking
    id = uuid.uuid4().hex
    peer.send(id, Phase.LEASED_GOAL, goal(ENDLESS))
    await peer.until(Phase.ACCEPTED)
    peer.leave()
    back = Peer(peer.interface, b"q" * 16)
    back.send(id, Phase.RESULT)
    await back.until(Phase.CANCELED)


async def test_malformed_goal_fails(asking: Asking) -> None:
    peer, _ = asking
    peer.send(uuid.uuid4().hex, Phase.GOAL, b"\0\1")
    with pytest.raises(ConversionError, match="is not a serialized"):
        await peer.next()


async def test_goal_without_a_server_fails(world: RosWorld) -> None:
    interface = await interface_of(ActionClientInterface, world, "/nowhere", [])
    peer = Peer(interface)
    peer.send(uuid.uuid4().hex, Phase.GOAL, goal(1))
    with pytest.raises(NotFound, match="action /nowhere did not appear"):
        await peer.next()
    interface.close()

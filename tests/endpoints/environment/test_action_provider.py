"""Goals of rclpy's action client, which a peer of the environment carries out."""

from __future__ import annotations

import asyncio
import uuid
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")
pytest.importorskip("test_msgs", reason="needs ros-test-msgs: pip install '.[dev]'")

from rclpy.action import ActionClient
from rclpy.serialization import deserialize_message, serialize_message
from test_msgs.action import Fibonacci

from endpoints.data.frames import Phase
from endpoints.environment.action_provider import ActionProviderInterface
from rce.errors import RceError
from tests.support.endpoints.actions import Peer, interface_of, spinning
from tests.support.endpoints.ros_world import LIMIT, RosWorld


async def test_node_sends_goal_that_the_peer_carries_out(world: RosWorld) -> None:
    name, reports = f"/given_{uuid.uuid4().hex[:8]}", list[RceError]()
    interface = await interface_of(ActionProviderInterface, world, name, reports)
    peer = Peer(interface)
    client = ActionClient(world.other, Fibonacci, name)
    feedback: list[list[int]] = []
    async with spinning(world.other):
        assert await asyncio.to_thread(client.wait_for_server, LIMIT)
        accepted = client.send_goal_async(
            Fibonacci.Goal(order=2), lambda message: feedback.append(list(message.feedback.sequence))
        )
        asked = await peer.until(Phase.GOAL)
        assert deserialize_message(asked.payload, Fibonacci.Goal).order == 2
        peer.send(asked.msg_id, Phase.ACCEPTED)
        handle = await _done(accepted)
        assert handle.accepted
        topic = f"{name}/_action/feedback"
        await world.until(lambda: bool(world.ros.node.count_subscribers(topic)))
        peer.send(asked.msg_id, Phase.FEEDBACK, bytes(serialize_message(Fibonacci.Feedback(sequence=[1]))))
        async with asyncio.timeout(LIMIT):
            while not feedback:  # noqa: ASYNC110  # another thread receives it
                await asyncio.sleep(0.01)
        canceling = handle.cancel_goal_async()
        assert (await peer.until(Phase.CANCEL)).msg_id == asked.msg_id
        peer.send(asked.msg_id, Phase.CANCEL)
        assert len((await _done(canceling)).goals_canceling) == 1
        result = handle.get_result_async()
        peer.send(asked.msg_id, Phase.CANCELED, bytes(serialize_message(Fibonacci.Result(sequence=[1, 1]))))
        ended = await _done(result)
        assert (ended.status, list(ended.result.sequence)) == (5, [1, 1])

        second = client.send_goal_async(Fibonacci.Goal(order=3))
        asked = await peer.until(Phase.GOAL)
        peer.send(asked.msg_id, Phase.ACCEPTED)
        result = (await _done(second)).get_result_async()
        peer.leave()
        assert (await _done(result)).status == 6, "the goal of a peer that is gone is aborted"
        assert not (await _done(client.send_goal_async(Fibonacci.Goal(order=3)))).accepted, "nobody carries it out"
        interface.close()
        client.destroy()
    assert feedback == [[1]]
    assert any("goals unfinished" in str(error) for error in reports)


async def _done(future: Any) -> Any:
    """Wait for a future of rclpy."""
    async with asyncio.timeout(LIMIT):
        while not future.done():  # noqa: ASYNC110  # another thread completes it
            await asyncio.sleep(0.01)
    return future.result()

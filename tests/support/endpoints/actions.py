"""Ends of actions: a peer that collects messages, and a server and a client of the ROS action Fibonacci."""

from __future__ import annotations

import asyncio
import sys
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from test_msgs.action import Fibonacci

from endpoints.data.frames import Message, Phase
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import error_of
from endpoints.data.link import LoopLink
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosContext, RosInterface
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError
from tests.support.endpoints.ros_world import LIMIT, RosWorld

TYPE = "test_msgs/Fibonacci"
ENDLESS, REJECTED = 0, -1  # orders that the server carries out until it is told to cancel, or rejects
I = TypeVar("I", bound=RosInterface)  # noqa: E741


class Peer:
    """Peer of an interface under test."""

    def __init__(self, interface: RosInterface, id: bytes = b"p" * 16) -> None:
        self.id = id
        self.received: asyncio.Queue[Message] = asyncio.Queue()
        self.interface = interface
        interface.peers[id] = LoopLink("loop", lambda message, _: self.received.put_nowait(message), lambda _: None)

    def send(self, id: str, phase: Phase, payload: bytes = b"", *, error: bool = False) -> None:
        self.interface.receive(Message(self.id, id, payload, error=error, phase=phase), self.interface.peers[self.id])

    async def next(self, id: str = "") -> Message:
        """Return the next message, of this goal; raises the error with which a goal failed."""
        async with asyncio.timeout(LIMIT):
            message = await self.received.get()
            while id and message.msg_id != id:
                message = await self.received.get()
        if message.error:
            raise error_of(message)
        return message

    async def until(self, phase: Phase, id: str = "") -> Message:
        """Return the next message with this phase."""
        while (message := await self.next(id)).phase != phase:
            pass
        return message

    def tick(self) -> None:
        """Do what is due, as the endpoint does once a second."""
        self.interface.tick(time.monotonic())

    def leave(self) -> None:
        """End the connection, as the switchboard does."""
        del self.interface.peers[self.id]
        self.interface.left(self.id)
        if not self.interface.peers:
            self.interface.stopped()


async def interface_of(kind: type[I], world: RosWorld, action: str, reports: list[RceError]) -> I:
    """Return an open interface for an action."""
    context = RosContext(
        world.ros,
        HopRecorder(),
        InstalledTypes([Path(sys.prefix)]),
        lambda _, error: reports.append(error),
    )
    made = kind(InterfaceSpec("11" * 16, "user/env", "tag", kind.__name__, TYPE, action), context)
    await made.open()
    return made


class Server:
    """Action server that answers an order with the numbers below it, each also as feedback."""

    def __init__(self, node: Node, action: str) -> None:
        self._gone = threading.Event()
        self.handle = ActionServer(
            node,
            Fibonacci,
            action,
            self._execute,
            callback_group=ReentrantCallbackGroup(),
            goal_callback=lambda goal: GoalResponse.REJECT if goal.order == REJECTED else GoalResponse.ACCEPT,
            cancel_callback=lambda goal: CancelResponse.ACCEPT,
        )

    def _execute(self, goal: Any) -> Any:
        sequence: list[int] = []
        if goal.request.order == ENDLESS:
            while not goal.is_cancel_requested:
                if self._gone.wait(0.01):
                    return Fibonacci.Result()
            goal.canceled()
        else:
            for number in range(goal.request.order):
                sequence.append(number)
                goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
            goal.succeed()
        return Fibonacci.Result(sequence=sequence)

    def destroy(self) -> None:
        """Vanish, as a server that is killed."""
        if not self._gone.is_set():
            self._gone.set()
            self.handle.destroy()


@asynccontextmanager
async def spinning(node: Node) -> AsyncIterator[None]:
    """Spin a node in threads of its own."""
    executor = MultiThreadedExecutor(4, context=node.context)
    executor.add_node(node)
    stopped = threading.Event()

    def spin() -> None:
        while not stopped.is_set():
            executor.spin_once(timeout_sec=0.1)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        yield
    finally:
        stopped.set()
        await asyncio.to_thread(thread.join)
        executor.remove_node(node)
        executor.shutdown()

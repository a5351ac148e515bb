"""Workers in environments of the platform: a node `worker` in each, which the engine places."""

from __future__ import annotations

from contextlib import AsyncExitStack, suppress
from typing import Any, Self

import numpy as np
from rosbags.typesys import Stores, get_typestore

from rce.client import Robot
from rce.errors import NotFound
from rce.mapping.guard import NodeGuard
from rce.mapping.parallel.units import Answer, decode_answer
from rce.mapping.robot import NODE, start_node
from rce.protocol.messages import Qos

START_TIMEOUT = 120.0  # seconds; a node compiles its kernels at its first start
STALL_TIMEOUT = 60.0  # seconds without a sign of life, which a worker gives each second
TYPE, QOS = "std_msgs/UInt8MultiArray", Qos(reliability="reliable", durability="transient_local", depth=4)

store = get_typestore(Stores.ROS2_KILTED)
types = store.types


class EnvironmentWorker:
    """Worker in an environment of its own; a `RemoteWorker`."""

    def __init__(self, robot: Robot, tag: str) -> None:
        """Use a connected robot; `tag` is the name of the environment, which does not exist yet."""
        self._robot, self._tag = robot, tag
        self._stack = AsyncExitStack()
        self._last = b""

    @classmethod
    async def hire(cls, robot: Robot, tag: str) -> Self:
        """Create the environment, start the node, and wait until it is ready.

        Raises:
            RceError: The environment or the node did not start, or was lost.
        """
        worker = cls(robot, tag)
        try:
            await worker._start()
        except BaseException:
            await worker.close()
            raise
        return worker

    async def send(self, data: bytes) -> None:
        """Send an encoded unit.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The platform does not take the unit.
        """
        self._last = cdr(data)
        await self._guard.wait(self._units.publish(self._last), STALL_TIMEOUT, "a mapping worker to take a unit")

    async def receive(self) -> tuple[Answer, int]:
        """Wait for an answer, or a sign of life; return it with its size in bytes.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The worker gives no sign of life.
        """
        received = await self._guard.wait(self._answers.get(), STALL_TIMEOUT, "a mapping worker")
        return decode_answer(bytes_of(received)), len(received)

    async def close(self) -> None:
        """Destroy the environment, unless it is lost already.

        Raises:
            RceError: The environment may still exist.
        """
        await self._stack.aclose()

    async def _start(self) -> None:
        environment = self._robot.environment(self._tag, restart="no")
        self._stack.push_async_callback(self._destroy)  # also if its creation is not acknowledged in time
        await environment.__aenter__()
        self._guard = await self._stack.enter_async_context(NodeGuard(self._robot, environment, NODE, self._send_again))
        await start_node(environment, "worker", {})
        self._units = await environment.publisher("/units", TYPE, qos=QOS, raw=True)
        self._answers = await environment.subscriber("/answers", TYPE, qos=QOS, raw=True)
        await self._guard.wait(self._answers.get(), START_TIMEOUT, "a mapping worker to be ready")

    async def _destroy(self) -> None:
        with suppress(NotFound):
            await self._robot.destroy_environment(self._tag)

    async def _send_again(self) -> None:
        """Send the current unit again; a worker ignores the one at which it works, and answers the last one again."""
        if self._last:
            await self._units.publish(self._last)


def cdr(data: bytes) -> bytes:
    """Serialise bytes as `std_msgs/UInt8MultiArray`."""
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    message = types["std_msgs/msg/UInt8MultiArray"](layout=layout, data=np.frombuffer(data, np.uint8))
    return bytes(store.serialize_cdr(message, "std_msgs/msg/UInt8MultiArray"))


def bytes_of(received: bytes) -> bytes:
    """Deserialise a `std_msgs/UInt8MultiArray`."""
    message: Any = store.deserialize_cdr(received, "std_msgs/msg/UInt8MultiArray")
    return bytes(message.data)

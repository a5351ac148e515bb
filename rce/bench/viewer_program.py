"""Program of `rce bench viewers`: many guests that watch a camera, until the standard input ends.

It reads a `Task` as one line of JSON, writes `ready`, and in the end what it has `Seen`.
"""

from __future__ import annotations

import asyncio
import secrets
import sys
from collections.abc import Sequence
from contextlib import AsyncExitStack

import msgspec
import uvloop
from msgspec import Struct

from rce.client import Robot, Subscriber
from rce.client.connection import Message
from rce.protocol.messages import Delivery

TOPIC, TYPE = "/camera", "sensor_msgs/Image"


class Task(Struct, frozen=True):
    """Behaviour of the viewers.

    Attributes:
        count: Number of viewers.
        rates: Images per second that they want, in turn; 0 for all.
        format: Format of the images, without a codec.
        codec: Codec.
        url: Address of the platform.
        environment: Environment with the camera.
        user: User of the viewers.
        password: Password of the user.
        key: API key of the user instead.
    """

    count: int
    rates: Sequence[float] = (0.0,)
    format: str = "jpeg"
    codec: str = ""
    url: str = ""
    environment: str = ""
    user: str = ""
    password: str | None = None
    key: str | None = None


class Seen(Struct):
    """Messages that all viewers have received: the messages, their bytes, and how many of them are different."""

    messages: int = 0
    bytes: int = 0
    encoded: int = 0

    def add(self, other: Seen) -> None:
        """Add what other viewers have seen of other messages."""
        self.messages += other.messages
        self.bytes += other.bytes
        self.encoded += other.encoded


class Viewers:
    """The viewers of a task."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._seen = Seen()
        self._blobs: set[str] = set()  # a message that is encoded once has the same blob for all

    async def open(self, stack: AsyncExitStack) -> None:
        """Connect all of them."""
        task, prefix = self._task, secrets.token_hex(3)
        for number in range(task.count):
            name = f"@view_{prefix}_{number}"
            robot = Robot(task.url, user=task.user, robot=name, password=task.password, key=task.key)
            await stack.enter_async_context(robot)
            subscriber = await robot.environment(task.environment).subscriber(
                TOPIC,
                TYPE,
                format=task.format,
                codec=task.codec,
                delivery=Delivery(rate=task.rates[number % len(task.rates)]),
            )
            self.watch(subscriber)

    def watch(self, subscriber: Subscriber) -> None:
        """Count what a subscriber receives, in place of unpacking it."""
        subscriber._receive = self.count  # type: ignore[method-assign]

    def count(self, message: Message) -> None:
        """Count a message."""
        self._seen.messages += 1
        self._seen.bytes += sum(map(len, message.blobs.values()))
        self._blobs.update(message.blobs)

    def seen(self) -> Seen:
        """Return what was received."""
        self._seen.encoded = len(self._blobs)
        return self._seen


async def run(task: Task) -> None:
    """Watch until the standard input ends."""
    viewers = Viewers(task)
    async with AsyncExitStack() as stack:
        await viewers.open(stack)
        print("ready", flush=True)
        await asyncio.to_thread(sys.stdin.read)
        print(msgspec.json.encode(viewers.seen()).decode(), flush=True)


if __name__ == "__main__":
    uvloop.run(run(msgspec.json.decode(sys.stdin.readline(), type=Task)))  # viewers cost little on the shared processor

"""Messages between a robot and a node in its environment: continuous ones, and single ones."""

from __future__ import annotations

import asyncio
import json
import time
from contextlib import suppress
from typing import Any, TypeVar

from rce.client import Environment, Event, Publisher, Robot, ServiceClient, Stream, Subscriber
from rce.errors import NotFound, TimedOut
from rce.protocol.messages import Qos
from tests.support.e2e.real_platform import until

STRING = "std_msgs/String"
PERIOD = 0.02  # seconds between messages
LATENCY_LIMIT = 2.0  # seconds for an undisturbed message on a busy machine
RESTARTABLE_AFTER = 6.0  # seconds after which a node that ends is restarted
DEEP = Qos(reliability="reliable", depth=1000)
E = TypeVar("E")


class Traffic:
    """A robot that sends 50 numbers a second to a node in its environment, which sends them back."""

    def __init__(self, robot: Robot, environment: Environment, own_types: bool = True) -> None:
        """Without type support for the package Test (`own_types`) parameters are not checked."""
        self._own_types = own_types
        self.robot = robot
        self.environment = environment
        self.sent: dict[int, float] = {}
        self.received: dict[int, float] = {}
        self.duplicates: list[int] = []

    async def start(self) -> None:
        environment = self.environment
        await environment.set_parameter("str", environment.tag)
        await environment.add_node("relay", "Relay", "relay.py", args=STRING)
        if self._own_types:
            await environment.add_node("parameters", "Test", "paramTest.py")
            self.parameters = await environment.service_client("/parameterTest", "Test/ParameterTest")
        self._subscriber = await environment.subscriber(
            "/out_String", STRING, callback=self._receive, depth=1000, qos=DEEP
        )
        self._publisher = await environment.publisher("/in_String", STRING, qos=DEEP)
        self._task = asyncio.create_task(self._send())
        await self.wait_for_round_trip()
        self.began = time.monotonic()

    async def stop(self) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def wait_until_restartable(self) -> None:
        """Wait until the nodes have run long enough to be restarted when they end."""
        await asyncio.sleep(max(0.0, self.began + RESTARTABLE_AFTER - time.monotonic()))

    async def _send(self) -> None:
        number = 0
        while True:
            if self._publisher.offer({"data": str(number)}, keep=1000):
                self.sent[number] = time.monotonic()
            number += 1
            await asyncio.sleep(PERIOD)

    def _receive(self, message: dict[str, str]) -> None:
        number = int(message["data"])
        if number in self.received:
            self.duplicates.append(number)
        self.received[number] = time.monotonic()

    async def wait_for_round_trip(self, seconds: float = 60.0) -> None:
        """Wait until a message that is sent from now on has come back."""
        now = time.monotonic()
        await until(lambda: any(self.sent[number] > now for number in self.received), seconds, "traffic")
        assert not self.duplicates
        assert list(self.received) == sorted(self.received)

    async def check_undisturbed(self, since: float) -> None:
        """Assert that all messages sent since then have come back in time.

        A fault that holds them up does so for most of the time since then. A busy machine does not: it makes that time
        longer as well.
        """
        limit = max(LATENCY_LIMIT, (time.monotonic() - since) / 2)
        last = next(reversed(self.sent))
        await until(lambda: last in self.received, what=f"the message {last} of {self.robot.name}")
        late = {
            number: round(self.received.get(number, 1e9) - sent, 2)
            for number, sent in self.sent.items()
            if since < sent and number <= last and self.received.get(number, 1e9) - sent > limit
        }
        assert not late, f"{self.robot.name}: messages that are lost or late, by seconds: {late}"
        assert not self.duplicates

    async def parameter(self) -> str:
        """Return the parameter `str` as a node sees it."""
        answer = await call(self.parameters, {})
        value: str = json.loads(answer["msg"])["str"]
        return value


class Echo:
    """A node that sends messages back, and a robot's interfaces to it."""

    def __init__(self, say: Publisher, heard: Subscriber, name: str = "") -> None:
        self._say, self._heard, self._name = say, heard, name
        self._count = 0

    @classmethod
    async def of(cls, environment: Environment) -> Echo:
        await environment.add_node("echo", "rce_demo", "echo.py")
        heard = await environment.subscriber("/heard", STRING)
        return cls(await environment.publisher("/say", STRING), heard, environment.tag)

    async def answers(self, seconds: float = 60.0) -> None:
        """Send messages until one comes back: they are lost until DDS discovery has finished."""
        sent: set[str] = set()
        async with asyncio.timeout(seconds):
            while True:
                sent.add(self._send())
                with suppress(TimedOut):
                    await self._hear(sent, 1)
                    return

    async def once(self, seconds: float = 60.0) -> None:
        """Send one message and wait until it comes back."""
        await self._hear({self._send()}, seconds)

    def _send(self) -> str:
        self._count += 1
        text = f"{self._name} {self._count}"
        self._say.offer({"data": text})
        return text

    async def _hear(self, texts: set[str], seconds: float) -> None:
        end = time.monotonic() + seconds
        while (await self._heard.get(max(end - time.monotonic(), 0.001)))["data"] not in texts:
            pass


async def call(service: ServiceClient, request: Any, seconds: float = 60.0) -> Any:
    """Call the service of a node until it answers.

    The node may still be starting, and its first answer is lost if DDS discovery has not finished.
    """
    async with asyncio.timeout(seconds):
        while True:
            try:
                return await service.call(request, 10)
            except TimedOut:
                pass
            except NotFound as error:
                if "did not appear" not in str(error):
                    raise


async def next_event(events: Stream[Event], kind: type[E], word: str = "") -> E:
    """Return the next event of that kind whose text contains the word."""
    async with asyncio.timeout(60):
        async for event in events:
            if isinstance(event, kind) and word in str(event):
                return event
    raise AssertionError

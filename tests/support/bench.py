"""Robot and environment of benchmarks whose nodes a test plays."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any, cast

from rce.bench.nodes import Place
from rce.client import Environment, Robot
from rce.errors import TimedOut


class Topic:
    """Publisher or subscriber: `sent` has what was published, `messages` what will be received."""

    def __init__(self, on_message: Callable[[Any], None] | None = None) -> None:
        self.sent: list[Any] = []
        self.messages: deque[Any] = deque()
        self._on_message = on_message

    async def publish(self, message: Any) -> None:
        self.sent.append(message)
        if self._on_message is not None:
            self._on_message(message)

    async def get(self, timeout: float) -> Any:  # noqa: ASYNC109  # as Subscriber.get
        """Return the next message, or time out at once."""
        if not self.messages:
            raise TimedOut("nothing arrived")
        return self.messages.popleft()


class FakeEnvironment:
    """Environment that records what is added to it; its topics and services are those of `topics`, by name."""

    def __init__(self, tag: str = "bench", log: list[tuple[Any, ...]] | None = None) -> None:
        self.tag = tag
        self.log: list[tuple[Any, ...]] = [] if log is None else log
        self.topics: dict[str, Any] = {}

    async def __aenter__(self) -> FakeEnvironment:
        return self

    async def __aexit__(self, *error: object) -> None:
        self.log.append(("destroyed", self.tag))

    async def add_node(self, tag: str, package: str, executable: str, **options: str) -> None:
        self.log.append(("node", self.tag, tag, executable, options.get("args", "")))

    async def publisher(self, topic: str, type_name: str, raw: bool = False) -> Any:
        return self.topics.setdefault(topic, Topic())

    async def subscriber(self, topic: str, type_name: str) -> Any:
        return self.topics.setdefault(topic, Topic())

    async def service_client(self, service: str, type_name: str, raw: bool = False) -> Any:
        return self.topics[service]


class FakeRobot:
    """Robot that records its commands; its subscribers are the topics of the environment."""

    connection = None
    name = "bench"

    def __init__(self, log: list[tuple[Any, ...]]) -> None:
        self.log = log
        self.topics: dict[str, Topic] = {}

    def environment(self, tag: str, **options: Any) -> FakeEnvironment:
        self.log.append(("environment", tag, options))
        return FakeEnvironment(tag, self.log)

    async def add_interface(self, owner: str, tag: str, kind: str, type_name: str, addr: str) -> None:
        self.log.append(("interface", f"{owner}/{tag}", kind, addr))

    async def connect(self, one: str, other: str) -> None:
        self.log.append(("connect", one, other))

    async def publisher(self, tag: str, type_name: str, *, to: str, raw: bool) -> Any:
        self.log.append(("publisher", tag, to))
        return self.topics.setdefault(tag, Topic())

    async def subscriber(self, tag: str, type_name: str, *, to: str = "", raw: bool, format: str = "png") -> Any:
        self.log.append(("subscriber", to, raw, format))
        return self.topics.setdefault(to or tag, Topic())


def fake_place(stack: AsyncExitStack, *features: str) -> tuple[Place, FakeEnvironment, FakeRobot]:
    """Return a place with an environment and a robot that share one log."""
    environment = FakeEnvironment()
    robot = FakeRobot(environment.log)
    place = Place(cast(Robot, robot), cast(Environment, environment), stack, features)
    return place, environment, robot

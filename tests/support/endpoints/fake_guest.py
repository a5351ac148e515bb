"""Guest of a gateway whose environment a test plays."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Sequence
from typing import Any, cast

import msgspec
from msgspec import UNSET, Raw

from converters import TypeRegistry
from converters.definition import Definition
from endpoints.gateways.changes import Changes
from endpoints.gateways.guest import Guest
from endpoints.gateways.uses import Arrived, Kind, Use
from rce.control.calls.robots import Sort
from rce.control.calls.watching import RosGraph
from rce.errors import LimitExceeded, RceError
from rce.protocol.blobs import BinaryFrame, TextFrame
from rce.protocol.messages import DataMessage
from rce.protocol.names import parse_type


class FakeGuest:
    """Guest that records its uses and what it sends.

    Attributes:
        fails: Error of uses that are begun.
        full: Too many operations are in progress.
    """

    name = "ann/@rosbridge_1"
    user = "ann"

    def __init__(self, graph: RosGraph | None = None) -> None:
        self.uses: dict[tuple[str, str], Use] = {}  # by kind of the environment's interface and address
        self.options: dict[str, dict[str, Any]] = {}  # by tag
        self.dropped: list[str] = []
        self.sent: list[tuple[str, str, Any, dict[str, Any]]] = []  # address, msgID, value, fields
        self.frames: list[Any] = []
        self.fails: RceError | None = None
        self.full = False
        self.refuses: RceError | None = None
        self.paused: asyncio.Future[None] | None = None
        self.ros = graph or RosGraph([], [])
        self.tasks: set[asyncio.Task[None]] = set()
        self.auto = True
        self.changes = Changes()
        self.view = self

    def as_guest(self) -> Guest:
        return cast(Guest, self)

    def use(self, kind: Kind, address: str, type: str, receive: Any, failed: Any, **options: Any) -> Use:
        self.check_room()
        use = Use(f"u{len(self.options)}", address, type, receive, failed)
        self.uses[kind.environment, address] = use
        self.options[use.tag] = options
        if self.fails is not None:
            use.end(self.fails)
        elif self.auto:
            use.ready.set_result(None)
        return use

    def drop(self, use: Use) -> None:
        self.dropped.append(use.address)

    def interface(self, use: Use) -> None:
        return None

    def data(self, use: Use, msg_id: str, value: Any, failed: Callable[[RceError], None], **more: Any) -> None:
        if self.refuses is not None:
            failed(self.refuses)
            return
        decoded = msgspec.json.decode(value) if isinstance(value, Raw) else bytes(value)
        self.sent.append((use.address, msg_id, decoded, more))

    def send(self, *frames: Any) -> None:
        self.frames += decoded(frames)

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        self.paused = until

    async def graph(self, age: float = 1.0) -> RosGraph:
        await self.changes.settle()
        return self.ros

    async def present_graph(self, age: float = 1.0) -> RosGraph:
        return self.ros

    async def definitions(self, type: str, sort: Sort) -> dict[str, Definition]:
        return TypeRegistry().definitions(parse_type(type), sort)

    def run(self, work: Coroutine[Any, Any, None], size: int = 0) -> None:
        try:
            self.check_room()
        except LimitExceeded:
            work.close()
            raise
        task = asyncio.create_task(work)
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    def check_room(self) -> None:
        if self.full:
            raise LimitExceeded("too many operations are in progress")

    async def wait_for_room(self) -> None:
        """Return at once: the client reads everything."""

    async def finish(self) -> None:
        """Wait until everything that was begun is done."""
        while self.tasks:
            await asyncio.gather(*self.tasks)
        await asyncio.sleep(0)

    def deliver(self, use: Use, value: Any, msg_id: str = "1", blob: bytes | None = None, **fields: Any) -> list[Any]:
        """Let a message arrive; return the operations that the client gets."""
        message = DataMessage(use.tag, use.type, msg_id, **fields)
        return decoded(use.receive(Arrived(message, msgspec.json.encode(value) + b"}", blob)))


class FakePeer:
    """Client that records its errors."""

    def __init__(self, types: dict[str, str] | None = None) -> None:
        self.errors: list[tuple[str, Any]] = []
        self.paused: asyncio.Future[None] | None = None
        self._types = types or {}

    def report(self, error: RceError, id: Any = UNSET) -> None:
        self.errors.append((str(error), None if id is UNSET else msgspec.json.decode(id)))

    def pause_until(self, ready: asyncio.Future[None]) -> None:
        self.paused = ready

    async def type_of_topic(self, topic: str) -> str:
        if topic not in self._types:
            raise RceError(f"{topic} has no type")
        return self._types[topic]


def decoded(frames: Sequence[Any]) -> list[Any]:
    """Return frames as the client sees them: decoded JSON, or binary messages as bytes."""
    found: list[Any] = []
    for frame in frames:
        if isinstance(frame, BinaryFrame):
            found.append(frame.head + bytes(frame.data))
        else:
            found.append(msgspec.json.decode(frame.join() if isinstance(frame, TextFrame) else frame))
    return found

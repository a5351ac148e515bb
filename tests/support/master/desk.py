"""A Master without sockets and database in a loop whose time is turned by hand, and processes that join it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, TypeVar, cast

from master.graph import reconcile
from master.graph.records import Robot
from master.graph.state import State
from master.service import Master
from master.storage.store import Store
from rce.control.calls.call import BatchResult, Call, Nothing
from rce.control.calls.endpoints import Sync
from rce.control.calls.joining import Hello
from rce.control.connection import Control
from rce.errors import RceError, TimedOut
from rce.protocol import messages as m
from tests.support.hand_turned import HandTurnedLoop
from tests.support.master.fleet import interface

GRACE, ROBOT_GRACE = 30.0, 10.0  # seconds: of machines, and of Robot endpoints and robots
T = TypeVar("T")


def stored() -> asyncio.Future[None]:
    """Return a future that has resolved."""
    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    future.set_result(None)
    return future


class NoStore:
    """Store that keeps nothing."""

    async def load(self, state: State) -> None: ...

    def save(self, state: State) -> asyncio.Future[None]:
        return stored()

    async def run(self, work: Callable[[Any], Any], *, repeatable: bool = False) -> Any: ...


class Peer:
    """Process that has joined and answers every call at once, except those that it refuses or holds.

    `refuse` has its errors by type of call; calls of the types in `held` are answered by `release`.
    """

    def __init__(self, desk: Desk, hello: Hello) -> None:
        self.address = "memory"
        self.hello = hello
        self.arrived: list[Call[Any]] = []
        self.refuse: dict[type[Call[Any]], RceError] = {}
        self.held: set[type[Call[Any]]] = set()
        self._waiting: list[asyncio.Future[None]] = []
        self.lost: asyncio.Future[None] = desk.hand.create_future()
        self.fell_silent = False
        self._desk = desk
        process = reconcile.process_of(desk.state, hello)
        desk.hand.do(lambda: desk.master.process_tracker.joined(process, hello, cast(Control, self)))

    async def call(self, call: Call[Any], seconds: float = 0.0) -> object:
        self.arrived.append(call)
        refusal = self.refuse.get(type(call))
        if type(call) in self.held:
            self._waiting.append(asyncio.get_running_loop().create_future())
            try:
                async with asyncio.timeout(seconds or call.timeout):  # as Control does
                    await self._waiting[-1]
            except TimeoutError:
                raise TimedOut(f"memory did not answer {type(call).__name__}") from None
        if refusal is not None:
            raise refusal
        return BatchResult() if isinstance(call, Sync) else Nothing()

    def release(self) -> None:
        """Answer the oldest held call."""
        while (answer := self._waiting.pop(0)).done():
            pass  # it took too long
        self._desk.hand.do(lambda: answer.set_result(None))

    def close(self) -> None:
        """End the connection; the Master calls this."""
        if not self.lost.done():
            self.lost.set_result(None)

    def leave(self, *, silently: bool = False) -> None:
        """Lose the connection; `silently` as behind a cut line, so that the Master must give it up."""
        self.fell_silent = silently
        self._desk.hand.do(self.close)

    def got(self, kind: type[T]) -> list[T]:
        return [call for call in self.arrived if isinstance(call, kind)]


class Desk:
    """Master without sockets and database."""

    def __init__(self, hand: HandTurnedLoop) -> None:
        self.hand = hand
        self.master = hand.do(lambda: Master(cast(Store, NoStore()), ROBOT_GRACE, machine_grace=GRACE))
        self.state = self.master.state

    def robot(self) -> Peer:
        west = Peer(self, Hello("robot", "west", "", "", "1"))
        self.state.robots.put(Robot("ann/r1", "west", "s", events=True))
        return west

    def machine(self, name: str, **environments: str) -> Peer:
        runs = {f"ann/{tag}": run for tag, run in environments.items()}
        return Peer(self, Hello("container", name, "", "", "1", capacity=2, environments=runs))

    def endpoint(self, tag: str) -> Peer:
        """Join as the endpoint of an environment's current life."""
        return Peer(self, Hello("environment", f"ann/{tag}", "", "", self.run(tag)))

    def run(self, tag: str) -> str:
        return self.state.environments[f"ann/{tag}"].run

    def at(self, tag: str) -> str:
        return self.state.environments[f"ann/{tag}"].machine

    def do(self, *commands: m.Command) -> asyncio.Task[None]:
        """Begin to execute commands of ann, all at once."""

        async def all_of_them() -> None:
            await asyncio.gather(*(self.master.commands.execute("ann", command) for command in commands))

        return self.hand.begin(all_of_them())

    def made(self, tag: str, **options: Any) -> Peer:
        """Create an environment and join as its endpoint."""
        task = self.do(m.CreateContainer(tag, m.ContainerData(**options)))
        endpoint = self.endpoint(tag)
        assert task.done()
        return endpoint

    def wired(self) -> tuple[Peer, Peer]:
        """Return endpoint west with ann/r1, and ann/brain, whose interfaces `pose` are connected."""
        west = self.robot()
        self.machine("m1")
        brain = self.made("brain")
        self.do(
            interface("r1", "pose", "SubscriberConverter"),
            interface("brain", "pose", "PublisherInterface"),
            m.Connect("r1/pose", "brain/pose"),
        )
        return west, brain

    def turn(self, seconds: float) -> None:
        self.hand.turn(seconds)

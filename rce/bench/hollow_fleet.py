"""Machines, Robot endpoints, environments and robots of which only the control connections are real.

A Master cannot tell them from others: they join, join again after its restart, and answer its calls.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Callable

from msgspec.structs import replace
from twisted.internet.base import ReactorBase

from rce import __version__
from rce.bench.hollow import Hollow, done
from rce.control.calls.call import Nothing
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment, StopEnvironment
from rce.control.calls.joining import Hello, SetRemovedMachines, SetRemovedUsers, Welcome
from rce.control.calls.robots import Execute, Login
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.protocol import messages as m

HOST = "hollow"  # of all processes, so that each two can be linked
SPARE = 3  # slots of a machine, as a multiple of its share of the environments
JOINING = 50  # environments that connect at the same time: a larger crowd would exceed the backlog of the listener


class HollowProcess:
    """Process that joins the Master, and joins again whenever it loses the connection."""

    def __init__(self, fleet: HollowFleet, hello: Callable[[], Hello], token: str, handlers: Handlers) -> None:
        """Begin to join.

        Args:
            fleet: The fleet, which is told when the process joins.
            hello: Makes the Hello of each join, but for its token.
            token: The token of the first join.
            handlers: Handlers for the Master's calls.
        """
        self._fleet = fleet
        self._token = token
        self._credential = secrets.token_hex(16)  # by which it joins once it was welcomed, as a real process
        self._hello = hello
        self.client = ControlClient(fleet.reactor, fleet.master, self._next_hello, handlers, self._welcomed)
        self._task = asyncio.create_task(self.client.run())

    def _next_hello(self) -> Hello:
        return replace(self._hello(), token=self._token, credential=self._credential)

    def _welcomed(self, welcome: Welcome) -> None:
        self._token = welcome.credential
        self._fleet.joins += 1

    async def stop(self) -> None:
        """Close the connection."""
        self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await self._task


class Machine:
    """Task set with its environments, and a Robot endpoint with its robots."""

    def __init__(self, fleet: HollowFleet, number: int, capacity: int) -> None:
        self._fleet = fleet
        self._capacity = capacity
        self.name, self.endpoint_name = f"m{number}", f"e{number}"
        self.robots: list[str] = []
        self._runs: dict[str, str] = {}
        self.environments: dict[str, HollowProcess] = {}
        self._incarnation = secrets.token_hex(4)
        handlers = Handlers()
        handlers.on(StartEnvironment, self._start)
        handlers.on(StopEnvironment, self._stop)
        handlers.on(KeepEnvironments, self._keep)
        for kind in (SetRelays, SetRemovedMachines, SetRemovedUsers):
            handlers.on(kind, done)
        self._task_set = HollowProcess(fleet, self._hello, fleet.tokens[self.name], handlers)
        self.endpoint = HollowProcess(
            fleet, self._endpoint_hello, fleet.tokens[self.endpoint_name], Hollow().handlers()
        )

    def _hello(self) -> Hello:
        return Hello(
            *("container", self.name, "", __version__, self._incarnation, HOST),
            capacity=self._capacity,
            environments=self._runs,
            sockets="/hollow/{name}",
        )

    def _endpoint_hello(self) -> Hello:
        return Hello(
            *("robot", self.endpoint_name, "", __version__, self._incarnation, HOST, ["unix:/hollow"]),
            url="ws://127.0.0.1:1/",
            robots=self.robots,
        )

    async def _start(self, call: StartEnvironment) -> Nothing:
        spec = call.environment
        hello = Hello("environment", spec.name, "", __version__, spec.run, HOST)
        self._runs[spec.name] = spec.run
        async with self._fleet.joining:
            self.environments[spec.name] = HollowProcess(self._fleet, lambda: hello, spec.token, Hollow().handlers())
        return Nothing()

    async def _stop(self, call: StopEnvironment) -> Nothing:
        self._runs.pop(call.name, None)
        environment = self.environments.pop(call.name, None)
        if environment is not None:
            await environment.stop()
        return Nothing()

    async def _keep(self, call: KeepEnvironments) -> Nothing:
        for name in [name for name, run in self._runs.items() if run not in call.runs]:
            await self._stop(StopEnvironment(name))
        return Nothing()

    async def die(self) -> None:
        """End the task set, the endpoint and all environments without a goodbye."""
        processes = [self._task_set, self.endpoint, *self.environments.values()]
        await asyncio.gather(*(process.stop() for process in processes))


class HollowFleet:
    """All machines.

    Attributes:
        joins: Number of joins so far of all processes.
    """

    def __init__(self, reactor: ReactorBase, master: str, tokens: dict[str, str]) -> None:
        """Prepare a fleet.

        Args:
            reactor: Twisted's reactor.
            master: Control address of the Master.
            tokens: Join tokens of task sets and Robot endpoints by name; see `tokens`.
        """
        self.reactor = reactor
        self.master = master
        self.tokens = tokens
        self.joins = 0
        self.joining = asyncio.Semaphore(JOINING)
        self.machines: list[Machine] = []

    def add_machines(self, count: int, environments: int) -> None:
        """Start machines with room for SPARE times so many environments in all."""
        capacity = SPARE * -(-environments // count)
        self.machines = [Machine(self, number, capacity) for number in range(count)]

    def machine_of(self, robot: int) -> Machine:
        """Return the machine at whose endpoint a robot is."""
        return self.machines[robot % len(self.machines)]

    async def login(self, user: str, number: int, key: str) -> None:
        """Log robot `number` in."""
        machine, name = self.machine_of(number), f"r{number}"
        await machine.endpoint.client.call(Login(user, name, key))
        machine.robots.append(f"{user}/{name}")

    async def execute(self, user: str, number: int, command: m.Command) -> None:
        """Execute a command of robot `number`."""
        client = self.machine_of(number).endpoint.client
        (await client.call(Execute.of(f"{user}/r{number}", command))).raise_first_error()

    async def stop(self) -> None:
        """Close all connections."""
        await asyncio.gather(*(machine.die() for machine in self.machines))


def make_tokens(machines: int) -> dict[str, str]:
    """Return random join tokens of the task sets and Robot endpoints of so many machines, by name."""
    return {f"{kind}{number}": secrets.token_hex(8) for number in range(machines) for kind in "me"}


def as_setting(tokens: dict[str, str]) -> str:
    """Return the tokens in the form of RCE_TOKENS."""
    roles = {"m": "container", "e": "robot"}
    return ",".join(f"{roles[name[0]]}:{name}:{token}" for name, token in tokens.items())

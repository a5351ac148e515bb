"""What passes interfaces and connections, and what environments use: asked of the processes while somebody watches."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextvars import Context
from typing import NamedTuple, TypeVar

from twisted.logger import Logger

from master.carrier import Carrier
from master.records import Connection, State
from master.shown import Shown
from rce.calls.call import Call
from rce.calls.watching import CountTraffic, MeasureUsage, Traffic
from rce.errors import RceError
from rce.views import Kind, Rate, Usage

PERIOD = 3.0  # seconds
DIGITS = 3  # that are shown: what stays about the same is not told anew

log = Logger()
A = TypeVar("A")
Changed = dict[Kind, set[str]]
"""The keys of what looks different now, by kind."""


class Reading(NamedTuple):
    """What has been counted up to a time, of the loop."""

    time: float
    messages: int
    bytes: int
    drops: int

    def since(self, before: Reading | None) -> Rate | None:
        """None if it was not counted before, or began anew."""
        if before is None or self.time <= before.time or self.messages < before.messages or self.drops < before.drops:
            return None
        seconds = self.time - before.time
        return Rate(
            _short((self.messages - before.messages) / seconds),
            _short((self.bytes - before.bytes) / seconds),
            self.drops,
        )


class Spent(NamedTuple):
    """What an environment had used up to a time."""

    time: float
    seconds: float
    memory: int

    def since(self, before: Spent | None) -> Usage | None:
        if before is None or self.time <= before.time or self.seconds < before.seconds:
            return None
        return Usage(_short((self.seconds - before.seconds) / (self.time - before.time)), int(_short(self.memory)))


class Gauges:
    """Fills `rates` and `usage` of what is shown; rates are those of the last PERIOD."""

    def __init__(self, state: State, carrier: Carrier, shown: Shown) -> None:
        self._state = state
        self._carrier = carrier
        self._shown = shown
        self._watchers: list[Callable[[Changed], None]] = []
        self._running: asyncio.Task[None] | None = None
        self._counted: dict[str, Reading] = {}  # by id of the interface, and by its id and its peer's
        self._spent: dict[str, Spent] = {}  # by name of the environment

    def watch(self, changed: Callable[[Changed], None]) -> Callable[[], None]:
        """Measure from now on, and tell of what has changed, until what is returned is called."""
        self._watchers.append(changed)
        if self._running is None:
            self._running = asyncio.create_task(self._run(), context=Context())  # of nobody's request

        def leave() -> None:
            if changed in self._watchers:
                self._watchers.remove(changed)
            if not self._watchers:
                self.close()

        return leave

    def close(self) -> None:
        """Measure no more; nothing old is shown."""
        self._watchers.clear()
        if self._running is not None:
            self._running.cancel()
            self._running = None
        self._counted, self._spent = {}, {}
        self._shown.rates, self._shown.usage = {}, {}

    async def _run(self) -> None:
        while True:
            rest = asyncio.create_task(asyncio.sleep(PERIOD))
            try:
                changed = await self.measure()
                for watcher in list(self._watchers):
                    watcher(changed)
            except Exception:  # noqa: BLE001  # a defect must not end the figures for good
                log.failure("defect while measuring")
            await rest

    async def measure(self) -> Changed:
        """Ask all at the same time, and show what has come."""
        state, shown = self._state, self._shown
        counted: dict[str, Reading] = {}
        spent: dict[str, Spent] = {}
        await asyncio.gather(
            *(self._count(name, counted) for name in self._endpoints()),
            *(self._measure(machine.name, spent) for machine in state.processes.by("container")),
        )
        rates = dict(self._rates(counted))
        usage = {name: found for name, each in spent.items() if (found := each.since(self._spent.get(name)))}
        different = _different(shown.rates, rates)
        environments = {name for name in _different(shown.usage, usage) if name in state.environments}
        self._counted, self._spent = counted, spent
        shown.rates, shown.usage = rates, usage
        return {
            "interfaces": {key for key in different if key in state.interfaces},
            "connections": {key for key in different if key in state.connections},
            "environments": environments,
            "machines": {state.environments[name].machine for name in environments} - {""},
        }

    # --- asking -------------------------------------------------------------------------------------------------------

    def _endpoints(self) -> set[str]:
        """The processes that have interfaces."""
        owners = {interface.spec.owner for interface in self._state.interfaces}
        return {self._state.host(owner) for owner in owners} - {""}

    async def _count(self, process: str, counted: dict[str, Reading]) -> None:
        traffic = await self._ask(process, CountTraffic())
        if traffic is not None:
            counted.update(_readings(traffic, asyncio.get_running_loop().time()))

    async def _measure(self, machine: str, spent: dict[str, Spent]) -> None:
        usage = await self._ask(machine, MeasureUsage())
        if usage is not None:
            now = asyncio.get_running_loop().time()
            spent.update({name: Spent(now, each.seconds, each.memory) for name, each in usage.environments.items()})

    async def _ask(self, process: str, call: Call[A]) -> A | None:
        try:
            return await self._carrier.ask(process, call, PERIOD)
        except RceError as error:  # it has no figures then; if it is away, that is told elsewhere
            log.debug("{process} was not measured: {error}", process=process, error=str(error))
            return None

    # --- rates --------------------------------------------------------------------------------------------------------

    def _rates(self, counted: dict[str, Reading]) -> Iterator[tuple[str, Rate]]:
        now = {key: rate for key, each in counted.items() if (rate := each.since(self._counted.get(key)))}
        for interface in self._state.interfaces:
            if interface.spec.id in now:
                yield interface.key, now[interface.spec.id]
        for connection in self._state.connections:
            if (both := self._both_ways(connection, now)) is not None:
                yield connection.key, both

    def _both_ways(self, connection: Connection, now: dict[str, Rate]) -> Rate | None:
        """What each side got from the other: topics go one way, services both."""
        one, other = (self._state.interfaces[key].spec.id for key in (connection.sender, connection.receiver))
        there, back = now.get(f"{one} {other}"), now.get(f"{other} {one}")
        if there is None or back is None:
            return None
        return Rate(there.messages + back.messages, there.bytes + back.bytes, there.drops + back.drops)


def _readings(traffic: Traffic, now: float) -> Iterator[tuple[str, Reading]]:
    for id, each in traffic.interfaces.items():
        sent, received = each.sent, each.received
        yield id, Reading(now, sent.messages + received.messages, sent.bytes + received.bytes, sent.drops)
        for peer, counts in each.peers.items():
            yield f"{id} {peer}", Reading(now, counts.messages, counts.bytes, counts.drops)


def _different(old: dict[str, A], new: dict[str, A]) -> set[str]:
    return {key for key in old.keys() | new.keys() if old.get(key) != new.get(key)}


def _short(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")

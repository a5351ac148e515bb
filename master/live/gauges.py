"""Rates of interfaces and connections and usage of environments, measured at the processes while somebody watches."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextvars import Context
from typing import NamedTuple, TypeVar

from twisted.logger import Logger

from master.execution.dispatcher import Dispatcher
from master.graph.records import Connection
from master.graph.state import State
from master.live.presenter import Presenter
from rce.api.views import Kind, Rate, Usage
from rce.control.calls.call import Call
from rce.control.calls.watching import CountTraffic, MeasureUsage, Traffic
from rce.errors import RceError

PERIOD = 3.0  # seconds
DIGITS = 3  # of rates: small changes are not sent

log = Logger()
A = TypeVar("A")
Changed = dict[Kind, set[str]]
"""Keys of changed views, by kind."""


class Reading(NamedTuple):
    """Counters at a time of the event loop."""

    time: float
    messages: int
    bytes: int
    drops: int
    unheard: int = 0

    def since(self, before: Reading | None) -> Rate | None:
        """Return the rate since an earlier reading, or None without one or after a restart."""
        if before is None or self.time <= before.time or self.messages < before.messages or self.drops < before.drops:
            return None
        seconds = self.time - before.time
        return Rate(
            _short((self.messages - before.messages) / seconds),
            _short((self.bytes - before.bytes) / seconds),
            self.drops,
            int(_short(self.unheard)),
        )


class UsageReading(NamedTuple):
    """Processor time and memory of an environment at a time."""

    time: float
    seconds: float
    memory: int

    def since(self, before: UsageReading | None) -> Usage | None:
        """Return the usage since an earlier reading, or None without one or after a restart."""
        if before is None or self.time <= before.time or self.seconds < before.seconds:
            return None
        return Usage(_short((self.seconds - before.seconds) / (self.time - before.time)), int(_short(self.memory)))


class Gauges:
    """Fills `rates` and `usage` of the presenter; rates are those of the last PERIOD."""

    def __init__(self, state: State, dispatcher: Dispatcher, presenter: Presenter) -> None:
        self._state = state
        self._dispatcher = dispatcher
        self._presenter = presenter
        self._watchers: list[Callable[[Changed], None]] = []
        self._running: asyncio.Task[None] | None = None
        self._counted: dict[str, Reading] = {}  # by id of the interface, and by its id and its peer's
        self._spent: dict[str, UsageReading] = {}  # by name of the environment

    def watch(self, changed: Callable[[Changed], None]) -> Callable[[], None]:
        """Measure periodically and call `changed` with changed keys; the returned function stops it."""
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
        """Measure no more, and remove the figures: they would be old."""
        self._watchers.clear()
        if self._running is not None:
            self._running.cancel()
            self._running = None
        self._counted, self._spent = {}, {}
        self._presenter.rates, self._presenter.usage = {}, {}

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
        """Ask all processes at once, and fill in what they answer."""
        state, presenter = self._state, self._presenter
        counted: dict[str, Reading] = {}
        spent: dict[str, UsageReading] = {}
        await asyncio.gather(
            *(self._count(name, counted) for name in self._endpoints()),
            *(self._measure(machine.name, spent) for machine in state.processes.by("container")),
        )
        rates = dict(self._rates(counted))
        usage = {name: found for name, each in spent.items() if (found := each.since(self._spent.get(name)))}
        different = _different(presenter.rates, rates)
        environments = {name for name in _different(presenter.usage, usage) if name in state.environments}
        self._counted, self._spent = counted, spent
        presenter.rates, presenter.usage = rates, usage
        return {
            "interfaces": {key for key in different if key in state.interfaces},
            "connections": {key for key in different if key in state.connections},
            "environments": environments,
            "machines": {state.environments[name].machine for name in environments} - {""},
        }

    # --- questions ----------------------------------------------------------------------------------------------------

    def _endpoints(self) -> set[str]:
        """Return the processes that have interfaces."""
        owners = {interface.owner for interface in self._state.interfaces}
        return {self._state.host(owner) for owner in owners} - {""}

    async def _count(self, process: str, counted: dict[str, Reading]) -> None:
        traffic = await self._ask(process, CountTraffic())
        if traffic is not None:
            counted.update(_readings(traffic, asyncio.get_running_loop().time()))

    async def _measure(self, machine: str, spent: dict[str, UsageReading]) -> None:
        usage = await self._ask(machine, MeasureUsage())
        if usage is not None:
            now = asyncio.get_running_loop().time()
            for name, each in usage.environments.items():
                spent[name] = UsageReading(now, each.seconds, each.memory)

    async def _ask(self, process: str, call: Call[A]) -> A | None:
        try:
            return await self._dispatcher.ask(process, call, PERIOD)
        except RceError as error:  # it has no figures this time
            log.debug("{process} was not measured: {error}", process=process, error=str(error))
            return None

    # --- rates --------------------------------------------------------------------------------------------------------

    def _rates(self, counted: dict[str, Reading]) -> Iterator[tuple[str, Rate]]:
        now = {key: rate for key, each in counted.items() if (rate := each.since(self._counted.get(key)))}
        for interface in self._state.interfaces:
            if interface.id in now:
                yield interface.key, now[interface.id]
        for connection in self._state.connections:
            if (both := self._both_ways(connection, now)) is not None:
                yield connection.key, both

    def _both_ways(self, connection: Connection, now: dict[str, Rate]) -> Rate | None:
        """Add up both directions: topics use one, services both."""
        one, other = (self._state.interfaces[key].id for key in (connection.sender, connection.receiver))
        there, back = now.get(f"{one} {other}"), now.get(f"{other} {one}")
        if there is None or back is None:
            return None
        return Rate(there.messages + back.messages, there.bytes + back.bytes, there.drops + back.drops)


def _readings(traffic: Traffic, now: float) -> Iterator[tuple[str, Reading]]:
    for id, each in traffic.interfaces.items():
        sent, received = each.sent, each.received
        yield id, Reading(now, sent.messages + received.messages, sent.bytes + received.bytes, sent.drops, each.unheard)
        for peer, counts in each.peers.items():
            yield f"{id} {peer}", Reading(now, counts.messages, counts.bytes, counts.drops)


def _different(old: dict[str, A], new: dict[str, A]) -> set[str]:
    return {key for key in old.keys() | new.keys() if old.get(key) != new.get(key)}


def _short(number: float) -> float:
    return float(f"{number:.{DIGITS}g}")

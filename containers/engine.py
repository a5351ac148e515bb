"""Base class of all engines, which start and stop environments for the task set.

An environment has a `name` (`userID/containerTag`), which at most one environment has at a time, and a `run`, which
tells the successive environments of one name apart. An engine keeps no state that only exists in memory: after a
restart of the task set it finds again whatever still runs. See docs/guides/write-an-engine.md.
"""

from __future__ import annotations

import asyncio
import re
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable, Mapping
from typing import NamedTuple
from weakref import WeakValueDictionary

from msgspec import Struct
from twisted.logger import Logger

from rce.control.calls.environments import DownloadTicket, EnvironmentSpec
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import InvalidRequest, NoCapacity, NotFound, RceError, StartFailed, Unavailable
from rce.process.metrics import Family
from rce.protocol.names import check_tag

log = Logger()
LAST_LINES = 20
LIMIT_REPORT_INTERVAL = 10.0  # seconds between two reports of a limit that one run hits
REMOVE_AGAIN = 5.0  # seconds until a removal that failed is tried again
RUN = re.compile(r"[0-9a-f]{32}")


class RunningEnvironment(Struct, frozen=True):
    """A running environment; `size` is in slots."""

    run: str
    size: int = 1


class EnvironmentEnded(Struct, frozen=True):
    """Report of an environment that ended by itself.

    `status` is its exit status, the negative number of the signal that ended it, or None if it is not known. `lines`
    are the last lines of its output.
    """

    name: str
    run: str
    reason: str
    status: int | None
    lines: list[str]


class _Start(NamedTuple):
    spec: EnvironmentSpec
    task: asyncio.Task[None]


class Engine(ABC):
    """Starts and stops environments; all operations are idempotent.

    Operations on one name run in the order of their calls; operations on different names run concurrently. A caller may
    not assume that an environment still runs when `start` returns (it may already have ended, which `ended` reports),
    nor that its endpoint has joined the Master.

    The task set sets `on_limit`, which is called when an environment hits a limit, `on_relays`, which is called when
    `relays` may have changed, and `request_ticket`, with which an engine that fetches packages itself asks the Master
    for the download of a digest.

    A subclass implements `launch`, `remove`, `recover`, `last_lines`, `usage` and `release`, and calls `report_end`.
    """

    fetches_packages = False  # True if the engine brings users' packages to environments itself
    host = ""  # identity of the machine on which all environments run; empty if the engine has several
    sockets = ""  # path of an environment's socket for data links, with {name}, {user} and {run}; empty: not dialled

    def __init__(self, capacity: int, features: Collection[str], ended: Callable[[EnvironmentEnded], None]) -> None:
        """Prepare an engine with `capacity` slots and these special features.

        `ended` is called for each environment that ended by itself, after everything it left has been removed. It is
        never called for one that was stopped.
        """
        self.capacity = capacity
        self.gpus = 0
        self.features = frozenset(features)
        self.on_relays: Callable[[], None] = lambda: None
        self.on_limit: Callable[[str, str, str], None] = lambda name, run, reason: None
        self.request_ticket: Callable[[str], Awaitable[DownloadTicket]] = _no_ticket
        self._ended = ended
        self._running: dict[str, RunningEnvironment] = {}
        self._starts: list[_Start] = []
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._tasks: set[asyncio.Task[None]] = set()
        self._later: dict[str, asyncio.Task[None]] = {}  # removals that are tried again, by name
        self._opened = asyncio.Event()
        self._limit_reported: dict[str, float] = {}  # time of the last report, by run

    @property
    def not_enforced(self) -> list[str]:
        """Options of environments that have no effect, and `egress` if programs reach more than it permits."""
        return []

    # --- for the task set ---------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Adopt running environments and remove what an earlier task set left half-started or dead.

        Called once, before all other operations.
        """
        self._running = await self.recover()
        self._opened.set()

    def running(self) -> dict[str, RunningEnvironment]:
        """Return the running environments by name, without those that are starting.

        An environment that ended a moment ago may still be included.
        """
        return dict(self._running)

    async def start(self, spec: EnvironmentSpec) -> None:
        """Start an environment; return when its process or container runs.

        An environment of the same name and another run is stopped first. If the same run is already starting, wait for
        that start. After any error nothing of the environment is left. If a caller is cancelled, the start is cancelled
        for all who wait for it, and its remains are removed in the background.

        Raises:
            NoCapacity: The machine lacks free slots or a special feature.
            LimitExceeded: The environment asks for more than the machine has.
            InvalidRequest: The specification is invalid or not supported by this engine.
            StartFailed: The environment did not start, or was stopped while it started.
        """
        _check(spec)
        under_way = (start for start in self._starts if start.spec.run == spec.run and not start.task.done())
        start = next(under_way, None)
        if start is None:
            self._check_capacity(spec)
            self._cancel(start for start in self._starts if start.spec.name == spec.name)
            start = _Start(spec, self._spawn(self._start(spec)))
            self._starts.append(start)
        try:
            await asyncio.wait({start.task})
        except asyncio.CancelledError:
            self._cancel([start])
            raise
        finally:
            self._starts = [other for other in self._starts if other is not start]
        if start.task.cancelled():
            raise StartFailed(f"environment {spec.name} was stopped while it started")
        try:
            start.task.result()
        except Unavailable as error:  # to the Master, Unavailable means that the outcome of its call is not known
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    async def stop(self, name: str) -> None:
        """Stop an environment or cancel its start; return when nothing of it is left.

        Raises:
            TimedOut: The environment does not end although it was killed; this goes on in the background.
        """
        _check_name(name)
        self._cancel(start for start in self._starts if start.spec.name == name)
        async with self._lock(name):
            await self._remove(name)
            self._running.pop(name, None)

    async def keep(self, runs: Collection[str]) -> None:
        """Stop every environment, running or starting, whose run is not in `runs`."""
        cancelled = self._cancel(start for start in self._starts if start.spec.run not in runs)
        others = [(name, each.run) for name, each in self._running.items() if each.run not in runs]
        await asyncio.gather(*(self._stop_run(name, run) for name, run in others))
        if cancelled:
            await asyncio.wait(cancelled)

    async def close(self) -> None:
        """Stop managing the environments, which keep running; cancel starts under way. No callback is called later."""
        self._cancel(self._starts)
        while self._tasks:
            await asyncio.wait(self._tasks)
        for task in list(self._later.values()):  # the next task set removes the rest
            task.cancel()
        await self.release()

    @property
    def relays(self) -> dict[str, str]:
        """Data relays of the engine's hosts, HOST:PORT; empty if it uses that of the task set."""
        return {}

    async def metrics(self) -> dict[str, list[Family]]:
        """Return the metrics of processes on the engine's machines by machine; empty if it has no machines."""
        return {}

    def set_relays(self, relays: Collection[str]) -> None:
        """Set the data relays of other machines, HOST:PORT, to which the engine's own relays may connect."""

    def set_removed_machines(self, machines: Mapping[str, float]) -> None:
        """Set when machines were removed; the engine's own relays refuse their certificates (see `rce.net.tls`)."""

    def set_master(self, master: str) -> None:
        """Set the control address of the Master that leads, to which the engine's own relays forward."""

    # --- for subclasses -----------------------------------------------------------------------------------------------

    @abstractmethod
    async def launch(self, spec: EnvironmentSpec) -> None:
        """Make the environment run. If this raises or is cancelled, `remove` is called next."""

    @abstractmethod
    async def remove(self, name: str) -> None:
        """End everything with this name, in whatever state, and remove what it left; do nothing if there is none."""

    @abstractmethod
    async def recover(self) -> dict[str, RunningEnvironment]:
        """Return the environments that still run and watch them; remove all else that this engine once made."""

    @abstractmethod
    async def last_lines(self, name: str) -> list[str]:
        """Return the last LAST_LINES lines of output of an environment that is not yet removed."""

    @abstractmethod
    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that environments have used, by name.

        One that has just started or ended may be missing.
        """

    @abstractmethod
    async def release(self) -> None:
        """Stop watching the environments, which keep running."""

    def report_end(self, name: str, run: str, reason: str, status: int | None) -> None:
        """Report that a launched or recovered environment has ended, whatever ended it. Called by subclasses."""
        self._spawn(self._handle_end(name, run, reason, status))

    def report_limit(self, name: str, run: str, reason: str) -> None:
        """Report that an environment runs on but is impaired, because it hit a limit. Called by subclasses.

        Repeated reports of one run are dropped for LIMIT_REPORT_INTERVAL.
        """
        environment, now = self._running.get(name), asyncio.get_running_loop().time()
        last = self._limit_reported.get(run, -LIMIT_REPORT_INTERVAL)
        if environment is not None and environment.run == run and now - last >= LIMIT_REPORT_INTERVAL:
            recent = {each: at for each, at in self._limit_reported.items() if now - at < LIMIT_REPORT_INTERVAL}
            self._limit_reported = recent | {run: now}
            self.on_limit(name, run, reason)

    def report_stray(self, name: str) -> None:
        """Report something that has the name of an environment which neither runs nor starts; it is removed."""
        self._spawn(self._remove_stray(name))

    # --- internal -----------------------------------------------------------------------------------------------------

    async def _start(self, spec: EnvironmentSpec) -> None:
        async with self._lock(spec.name):
            current = self._running.get(spec.name)
            if current is not None and current.run == spec.run:
                return
            if current is not None:
                await self._remove(spec.name)
                del self._running[spec.name]
            try:
                await self.launch(spec)
            except BaseException:
                try:
                    await self._remove(spec.name)
                except RceError as error:  # the caller gets the reason of the failed start
                    log.error(
                        "{name} did not start, and its remains were not removed: {error}",
                        name=spec.name,
                        error=str(error),
                    )
                raise
            self._running[spec.name] = RunningEnvironment(spec.run, spec.options.size)

    async def _remove_stray(self, name: str) -> None:
        async with self._lock(name):
            if name not in self._running:
                log.info("removing the remains of {name}", name=name)
                await self._remove(name)

    async def _stop_run(self, name: str, run: str) -> None:
        async with self._lock(name):
            current = self._running.get(name)
            if current is not None and current.run == run:
                await self._remove(name)
                del self._running[name]

    async def _handle_end(self, name: str, run: str, reason: str, status: int | None) -> None:
        await self._opened.wait()  # an environment may end while others are still being recovered
        async with self._lock(name):
            current = self._running.get(name)
            if current is None or current.run != run:
                return  # it was stopped
            del self._running[name]
            lines = await self.last_lines(name)
            try:
                await self._remove(name)
            except RceError as error:  # the end must be reported all the same
                log.error("{name} ended, but its remains were not removed: {error}", name=name, error=str(error))
        self._ended(EnvironmentEnded(name, run, reason, status, lines))

    async def _remove(self, name: str) -> None:
        """Remove an environment; what cannot be removed now is removed later, unless it has another life by then."""
        try:
            await self.remove(name)
        except RceError:
            if name not in self._later:
                task = self._later[name] = asyncio.create_task(self._remove_later(name, self._running.get(name)))
                task.add_done_callback(lambda _: self._later.pop(name, None))
            raise

    async def _remove_later(self, name: str, life: RunningEnvironment | None) -> None:
        while True:
            await asyncio.sleep(REMOVE_AGAIN)
            async with self._lock(name):
                current = self._running.get(name)
                if current is not None and current is not life:
                    return  # its start or its removal takes what is left of earlier ones
                try:
                    await self.remove(name)
                except RceError as error:
                    log.warn("the remains of {name} are still not removed: {error}", name=name, error=str(error))
                    continue
                self._running.pop(name, None)
                return

    def _check_capacity(self, spec: EnvironmentSpec) -> None:
        lacking = sorted(set(spec.options.specialFeatures) - self.features)
        if lacking:
            raise NoCapacity(f"environment {spec.name}: this machine has no {', '.join(lacking)}", lacking=lacking)
        sizes = {name: each.size for name, each in self._running.items()}
        sizes |= {start.spec.name: start.spec.options.size for start in self._starts}
        sizes.pop(spec.name, None)
        used, size = sum(sizes.values()), spec.options.size
        if used + size > self.capacity:
            raise NoCapacity(
                f"environment {spec.name} needs {size} slots; {used} of this machine's {self.capacity} are in use",
                size=size,
                used=used,
                capacity=self.capacity,
            )

    def _cancel(self, starts: Iterable[_Start]) -> list[asyncio.Task[None]]:
        """Cancel starts, each once only: a second cancellation would interrupt its clean-up."""
        cancelled = [start for start in list(starts) if start in self._starts]
        self._starts = [start for start in self._starts if start not in cancelled]
        for start in cancelled:
            start.task.cancel()
        return [start.task for start in cancelled]

    def _lock(self, name: str) -> asyncio.Lock:
        lock = self._locks.get(name)
        if lock is None:
            lock = self._locks[name] = asyncio.Lock()
        return lock

    def _spawn(self, work: Coroutine[None, None, None]) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)
        return task

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) and not isinstance(error, RceError):
            log.error("defect in an engine: {error!r}", error=error)


async def _no_ticket(digest: str) -> DownloadTicket:
    raise NotFound(f"package {digest} cannot be fetched: this engine has no Master to ask")


def _check_name(name: str) -> None:
    """Refuse invalid names, since names become parts of paths and labels of containers and networks."""
    user, _, tag = name.partition("/")
    check_tag(user, "userID")
    check_tag(tag, "containerTag")


def _check(spec: EnvironmentSpec) -> None:
    _check_name(spec.name)
    if not RUN.fullmatch(spec.run):
        raise InvalidRequest(f"environment {spec.name}: run {spec.run[:80]!r} is not 32 hex digits", field="run")

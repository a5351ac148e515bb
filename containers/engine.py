"""What every engine does for the task set, and the six things in which engines differ.

An environment has a `name` (`userID/containerTag`), which is taken by one at a time, and a `run`, which tells its lives
apart. An engine finds again by itself what runs after the task set was restarted: nothing here is kept in memory only.
"""

from __future__ import annotations

import asyncio
import re
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Collection, Coroutine, Iterable
from typing import NamedTuple
from weakref import WeakValueDictionary

from msgspec import Struct
from twisted.logger import Logger

from rce.calls.environments import EnvironmentSpec, Ticket
from rce.calls.watching import Used
from rce.errors import InvalidRequest, NoCapacity, NotFound, RceError, StartFailed, Unavailable
from rce.metrics import Family
from rce.names import check_tag

log = Logger()
LAST_LINES = 20
QUIET = 10.0  # seconds
RUN = re.compile(r"[0-9a-f]{32}")


class Life(Struct, frozen=True):
    """A running environment; `size` is in slots."""

    run: str
    size: int = 1


class Ended(Struct, frozen=True):
    """An environment ended by itself. `status` is its exit status, negative the signal, None where nobody knows."""

    name: str
    run: str
    reason: str
    status: int | None
    lines: list[str]  # the last of its output


class _Start(NamedTuple):
    spec: EnvironmentSpec
    task: asyncio.Task[None]


class Engine(ABC):
    """Starts and stops environments. Every operation may be repeated: what is so already stays so.

    Operations on one name wait for each other in the order of their calls; those on different names run side by side.
    A caller may not assume that an environment still runs when `start` returns (it may have ended since: `ended` is
    told), nor that its endpoint has joined the Master.

    `on_limit` is the task set's to set, and `ticket`, by which an engine with `fetches` gets the package of a digest.

    A subclass implements `launch`, `remove`, `recover`, `last_lines`, `usage` and `release`, and calls `died`.
    """

    fetches = False  # whether it brings users' packages to environments itself

    def __init__(self, capacity: int, features: Collection[str], ended: Callable[[Ended], None]) -> None:
        """`ended` is called after all that the environment left is removed; never for one that was told to stop."""
        self.capacity = capacity
        self.gpus = 0
        self.features = frozenset(features)
        self.on_limit: Callable[[str, str, str], None] = lambda name, run, reason: None
        self.ticket: Callable[[str], Awaitable[Ticket]] = _no_ticket
        self._ended = ended
        self._lives: dict[str, Life] = {}
        self._starts: list[_Start] = []
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()
        self._tasks: set[asyncio.Task[None]] = set()
        self._opened = asyncio.Event()
        self._told: dict[str, float] = {}  # when the limit of a run was last told of

    # --- for the task set ---------------------------------------------------------------------------------------------

    async def open(self) -> None:
        """Adopt what runs, and remove what an earlier task set left half-started or dead; once, before all else."""
        self._lives = await self.recover()
        self._opened.set()

    def running(self) -> dict[str, Life]:
        """What really runs, by name, as far as the engine has heard: neither what starts nor what has ended."""
        return dict(self._lives)

    async def start(self, spec: EnvironmentSpec) -> None:
        """Start an environment; returns when its process or container runs.

        One of the same name and another run is stopped first; a start of the same run under way is joined. After any
        error nothing is left of it. NoCapacity, LimitExceeded, InvalidRequest, StartFailed (also when a `stop` came in
        between). Cancelling a caller cancels the start, also for those who joined; its remains go in the background.
        """
        _check(spec)
        under_way = (start for start in self._starts if start.spec.run == spec.run and not start.task.done())
        start = next(under_way, None)
        if start is None:
            self._check_room(spec)
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
        except Unavailable as error:  # that would mean: of the Master's call nothing is known, try again
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    async def stop(self, name: str) -> None:
        """Stop an environment, or cancel its start; returns when nothing of it is left. TimedOut if it resists."""
        _check_name(name)
        self._cancel(start for start in self._starts if start.spec.name == name)
        async with self._lock(name):
            await self.remove(name)
            self._lives.pop(name, None)

    async def keep(self, runs: Collection[str]) -> None:
        """Stop every environment, also one that starts, whose run is not among `runs`."""
        started = self._cancel(start for start in self._starts if start.spec.run not in runs)
        doomed = [self._stop_life(name, life.run) for name, life in self._lives.items() if life.run not in runs]
        await asyncio.gather(*doomed)
        if started:
            await asyncio.wait(started)

    async def close(self) -> None:
        """Let go of the environments, which run on; starts under way are cancelled. Nothing is reported after this."""
        self._cancel(self._starts)
        while self._tasks:
            await asyncio.wait(self._tasks)
        await self.release()

    @property
    def relays(self) -> list[str]:
        """The data relays of its machines, relay:HOST:PORT, where it has some of its own."""
        return []

    async def metrics(self) -> dict[str, list[Family]]:
        """What the processes of its machines count of themselves, by the machine, where it has some of its own."""
        return {}

    def know(self, relays: Collection[str]) -> None:
        """The data relays of other machines, HOST:PORT, for relays of its own."""

    # --- for subclasses -----------------------------------------------------------------------------------------------

    @abstractmethod
    async def launch(self, spec: EnvironmentSpec) -> None:
        """Make the environment run. When it raises or is cancelled, `remove` is called next."""

    @abstractmethod
    async def remove(self, name: str) -> None:
        """End all that carries this name, in whatever state it is, and remove what it left. Nothing there is well."""

    @abstractmethod
    async def recover(self) -> dict[str, Life]:
        """What runs from before, watched from now on; all else that this engine once made is removed."""

    @abstractmethod
    async def last_lines(self, name: str) -> list[str]:
        """The last LAST_LINES lines of output of an environment that is not yet removed."""

    @abstractmethod
    async def usage(self) -> dict[str, Used]:
        """What environments have used, by name; of one that has just begun or ended nothing may be known."""

    @abstractmethod
    async def release(self) -> None:
        """Stop watching; the environments run on."""

    def died(self, name: str, run: str, reason: str, status: int | None) -> None:
        """To be called when an environment that was launched or recovered has ended, whoever ended it."""
        self._spawn(self._bury(name, run, reason, status))

    def limit_hit(self, name: str, run: str, reason: str) -> None:
        """To be called when an environment runs on, but less well than its user may think.

        One that goes on hitting its limits is not told of each time.
        """
        life, now = self._lives.get(name), asyncio.get_running_loop().time()
        if life is not None and life.run == run and now - self._told.get(run, -QUIET) >= QUIET:
            self._told = {other: told for other, told in self._told.items() if now - told < QUIET} | {run: now}
            self.on_limit(name, run, reason)

    def stray(self, name: str) -> None:
        """To be called when there is something with the name of an environment that neither runs nor starts."""
        self._spawn(self._remove_stray(name))

    # --- within -------------------------------------------------------------------------------------------------------

    async def _start(self, spec: EnvironmentSpec) -> None:
        async with self._lock(spec.name):
            life = self._lives.get(spec.name)
            if life is not None and life.run == spec.run:
                return
            if life is not None:
                await self.remove(spec.name)
                del self._lives[spec.name]
            try:
                await self.launch(spec)
            except BaseException:
                try:
                    await self.remove(spec.name)
                except RceError as error:  # why it did not start matters more
                    log.error("{name} did not start, and its remains stay: {error}", name=spec.name, error=str(error))
                raise
            self._lives[spec.name] = Life(spec.run, spec.options.size)

    async def _remove_stray(self, name: str) -> None:
        async with self._lock(name):
            if name not in self._lives:
                log.info("removing what is left of {name}", name=name)
                await self.remove(name)

    async def _stop_life(self, name: str, run: str) -> None:
        async with self._lock(name):
            life = self._lives.get(name)
            if life is not None and life.run == run:
                await self.remove(name)
                del self._lives[name]

    async def _bury(self, name: str, run: str, reason: str, status: int | None) -> None:
        await self._opened.wait()  # what ends while others are still being recovered is on the list by then
        async with self._lock(name):
            life = self._lives.get(name)
            if life is None or life.run != run:
                return  # it was told to stop
            del self._lives[name]
            lines = await self.last_lines(name)
            try:
                await self.remove(name)
            except RceError as error:  # its owner must hear of the death all the same
                log.error("{name} ended, but {error}", name=name, error=str(error))
        self._ended(Ended(name, run, reason, status, lines))

    def _check_room(self, spec: EnvironmentSpec) -> None:
        lacking = sorted(set(spec.options.specialFeatures) - self.features)
        if lacking:
            raise NoCapacity(f"environment {spec.name}: this machine has no {', '.join(lacking)}", lacking=lacking)
        sizes = {name: life.size for name, life in self._lives.items()}
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
        """Each start is cancelled once only, so that its clean-up is not."""
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
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) and not isinstance(error, RceError):
            log.error("defect in an engine: {error!r}", error=error)


async def _no_ticket(digest: str) -> Ticket:
    raise NotFound(f"there is no Master to ask for package {digest}")


def _check_name(name: str) -> None:
    """Names become names of directories, containers and networks."""
    user, _, tag = name.partition("/")
    check_tag(user, "userID")
    check_tag(tag, "containerTag")


def _check(spec: EnvironmentSpec) -> None:
    _check_name(spec.name)
    if not RUN.fullmatch(spec.run):
        raise InvalidRequest(f"environment {spec.name}: run {spec.run[:80]!r} is not 32 hex digits", field="run")

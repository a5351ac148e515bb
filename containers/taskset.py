"""The Container task set towards the Master: joins it, does what it asks, reports what ends by itself."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from uuid import uuid4

from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.data_relay import DataRelay
from containers.engine import Ended, Engine
from containers.fetching import Fetcher
from containers.packages import PackageCache
from rce import metrics
from rce.calls.call import Nothing
from rce.calls.environments import (
    EnvironmentDied,
    FetchPackage,
    KeepEnvironments,
    KnowRelays,
    LimitReached,
    StartEnvironment,
    StopEnvironment,
)
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import MeasureUsage, Metrics, ReadMetrics, Usage, Used
from rce.control import Handlers, MasterLink
from rce.credential import Credential, stay_joined
from rce.errors import RceError
from rce.ready import Ready, announce
from rce.tls import Tls

log = Logger()
_launches = metrics.Timing("rce_environment_launch_seconds", "Time until an environment's process or container runs")
MakeEngine = Callable[[Callable[[Ended], None]], Engine]


class TaskSet:
    """One machine's environments, in the Master's service."""

    def __init__(
        self,
        reactor: ReactorBase,
        master: str,
        name: str,
        credential: Credential,
        make_engine: MakeEngine,
        packages: Path,
        relay: DataRelay | None = None,
        entry: str = "",
        tls: Tls | None = None,
    ) -> None:
        """`packages` is the directory for users' packages, fetched at the Master's HTTP entry (see `Fetcher`); `relay`
        is the one that the engine's environments are admitted to.
        """
        self._name = name
        self._relay = relay or DataRelay()
        self._credential = credential
        self._incarnation = uuid4().hex
        self._engine = make_engine(self._ended)
        self._engine.on_limit = self._limit_hit
        self._reports: set[asyncio.Task[None]] = set()
        handlers = Handlers()
        handlers.on(StartEnvironment, self._start)
        handlers.on(StopEnvironment, self._stop)
        handlers.on(KeepEnvironments, self._keep)
        handlers.on(KnowRelays, self._know)
        handlers.on(MeasureUsage, self._measure)
        handlers.on(ReadMetrics, self._read_metrics)
        self._link = MasterLink(reactor, master, self._hello, handlers, self._welcomed, tls)
        self._engine.ticket = lambda digest: self._link.call(FetchPackage(digest))
        self._packages = PackageCache(packages, Fetcher(self._link, master, entry, tls).fetch)
        self._starting: set[str] = set()

    async def run(self, *, stop_environments: bool) -> None:
        """Serve the Master until cancelled or refused (its error is raised).

        At the end the environments are stopped, or run on until the next task set of this machine adopts them.
        """
        self._packages.open()
        await self._engine.open()
        log.info("{count} environments adopted", count=len(self._engine.running()))
        try:
            await stay_joined(self._link, self._credential)
        finally:
            try:
                if stop_environments:
                    await self._engine.keep([])
            finally:
                for report in self._reports:
                    report.cancel()
                await self._engine.close()

    def _welcomed(self, welcome: Welcome) -> None:
        self._credential.keep(welcome)
        announce(Ready("container"))

    def _hello(self) -> Hello:
        return Hello(
            role="container",
            name=self._name,
            token=self._credential.secret,
            version=version("rce"),
            incarnation=self._incarnation,
            addresses=[*([self._relay.address] if self._relay.address else []), *self._engine.relays],
            capacity=self._engine.capacity,
            features=sorted(self._engine.features),
            gpus=self._engine.gpus,
            environments={name: life.run for name, life in self._engine.running().items()},
        )

    async def _start(self, call: StartEnvironment) -> Nothing:
        spec = call.environment
        self._starting.add(spec.run)
        began = time.perf_counter()
        try:
            await self._packages.provide(spec.run, [] if self._engine.fetches else spec.packages)
            await self._engine.start(spec)
        except RceError as error:
            log.warn("{name} was not started: {error}", name=spec.name, run=spec.run, error=str(error))
            raise
        finally:
            self._starting.discard(spec.run)
            await self._release()
        _launches.of().since(began)
        log.info("{name} is started", name=spec.name, run=spec.run)
        return Nothing()

    async def _stop(self, call: StopEnvironment) -> Nothing:
        await self._engine.stop(call.name)
        await self._release()
        log.info("{name} is stopped", name=call.name)
        return Nothing()

    async def _keep(self, call: KeepEnvironments) -> Nothing:
        await self._engine.keep(call.runs)
        await self._release()
        return Nothing()

    async def _know(self, call: KnowRelays) -> Nothing:
        self._relay.know(call.relays)
        self._engine.know(call.relays)
        return Nothing()

    async def _measure(self, _: MeasureUsage) -> Usage:
        return Usage(await self._engine.usage())

    async def _read_metrics(self, _: ReadMetrics) -> Metrics:
        used, parts = await asyncio.gather(self._engine.usage(), self._engine.metrics())
        own = metrics.families("container", self._relay.families, lambda: self._families(used))
        return Metrics(metrics.with_parts(own, "node", parts) if parts else own)

    def _families(self, used: dict[str, Used]) -> list[metrics.Family]:
        slots = sum(life.size for life in self._engine.running().values())
        sizes: dict[tuple[str, ...], float] = {("used",): slots, ("free",): self._engine.capacity - slots}
        names = ["user", "environment"]
        seconds = {tuple(name.split("/")): each.seconds for name, each in used.items()}
        memory = {tuple(name.split("/")): each.memory for name, each in used.items()}
        return [
            metrics.gauge("rce_slots", "Slots of this machine", ["state"], sizes),
            metrics.counted("rce_environment_cpu_seconds", "Processor time of an environment", names, seconds),
            metrics.gauge("rce_environment_memory_bytes", "Memory of an environment", names, memory),
        ]

    async def _release(self) -> None:
        """Packages that no environment has any more need not stay."""
        running = {life.run for life in self._engine.running().values()}
        await self._packages.release(running | self._starting)

    def _ended(self, ended: Ended) -> None:
        reason = "\n".join([ended.reason, *ended.lines])
        log.warn("{name}: {reason}", name=ended.name, run=ended.run, reason=reason)
        self._tell(EnvironmentDied(ended.name, ended.run, reason))

    def _limit_hit(self, name: str, run: str, reason: str) -> None:
        log.info("{name}: {reason}", name=name, run=run, reason=reason)
        self._tell(LimitReached(name, run, reason))

    def _tell(self, call: EnvironmentDied | LimitReached) -> None:
        report = asyncio.create_task(self._report(call))
        self._reports.add(report)
        report.add_done_callback(self._reports.discard)

    async def _report(self, call: EnvironmentDied | LimitReached) -> None:
        try:
            await self._link.call(call)
        except RceError as error:
            # Of an end it learns when this task set joins again: the run is not among those that its Hello names.
            log.info("the Master was not told of {name}: {error}", name=call.name, error=str(error))

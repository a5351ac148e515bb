"""The Container task set's side of the control protocol: it joins the Master, serves its calls and reports ends."""

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
from containers.engine import Engine, EnvironmentEnded
from containers.fetching import Fetcher
from containers.packages import PackageCache
from containers.recordings.calls import RecordingCalls
from containers.recordings.receiver import RecordingReceiver
from containers.recordings.store import RecordingStore
from rce.control.calls.call import Nothing
from rce.control.calls.environments import (
    EnvironmentDied,
    FetchPackage,
    KeepEnvironments,
    LimitReached,
    ReportRelays,
    SetRelays,
    StartEnvironment,
    StopEnvironment,
)
from rce.control.calls.joining import Hello, SetRemovedMachines, Welcome
from rce.control.calls.recordings import BeginRecording
from rce.control.calls.watching import EnvironmentUsage, MeasureUsage, Metrics, ReadMetrics, Usage
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.control.credential import Credential, stay_joined
from rce.errors import RceError, StartFailed
from rce.net.tls import Tls
from rce.process import metrics
from rce.process.ready import Ready, announce

log = Logger()
_launches = metrics.Timing("rce_environment_launch_seconds", "Time until an environment's process or container runs")
MakeEngine = Callable[[Callable[[EnvironmentEnded], None]], Engine]


class TaskSet:
    """Starts and stops the environments of one machine for the Master."""

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
        recordings: tuple[RecordingStore, RecordingReceiver] | None = None,
    ) -> None:
        """Prepare a task set.

        Args:
            reactor: Twisted's reactor.
            master: Control address of the Master, a Twisted client endpoint.
            name: Name of the task set, unique on the platform.
            credential: Credential by which it joins.
            make_engine: Makes the engine; its argument is the callback for environments that ended.
            packages: Directory for users' packages, which are fetched from the Master's HTTP entry (see `Fetcher`).
            relay: Data relay to which the engine adds its environments.
            entry: URL of the Master's HTTP entry (see `Fetcher`).
            tls: Certificate and CA for the connection to the Master.
            recordings: Store of recordings, and what receives those of the engine's environments.
        """
        self._name = name
        self._tls = tls
        self._relay = relay or DataRelay()
        self._credential = credential
        self._incarnation = uuid4().hex
        self._engine = make_engine(self._ended)
        self._engine.on_limit = self._limit_hit
        self._engine.on_relays = self._report_relays
        self._reported_relays: dict[str, str] = {}
        self._reports: set[asyncio.Task[None]] = set()
        handlers = Handlers()
        handlers.on(StartEnvironment, self._start)
        handlers.on(StopEnvironment, self._stop)
        handlers.on(KeepEnvironments, self._keep)
        handlers.on(SetRelays, self._know)
        handlers.do(SetRemovedMachines, self._refuse_removed)
        handlers.on(MeasureUsage, self._measure)
        handlers.on(ReadMetrics, self._read_metrics)
        if recordings is not None:
            RecordingCalls(recordings[0]).add_to(handlers)
            recordings[1].ask_quota = lambda environment, recorder: self._link.call(
                BeginRecording(environment, recorder)
            )
        self._link = ControlClient(reactor, master, self._hello, handlers, self._welcomed, tls)
        self._engine.request_ticket = lambda digest: self._link.call(FetchPackage(digest))
        self._packages = PackageCache(packages, Fetcher(self._link, master, entry, tls).fetch)
        self._starting: dict[str, str] = {}  # environments by run
        self._stopped: set[str] = set()  # runs that were stopped while they started

    async def run(self, *, stop_environments: bool) -> None:
        """Serve the Master until cancelled or refused; the Master's error is then raised.

        At the end the environments are stopped, or keep running until the next task set of this machine adopts them.
        """
        self._packages.open()
        await self._engine.open()
        log.info("adopted {count} environments", count=len(self._engine.running()))
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
        self._engine.set_master(self._link.master)
        announce(Ready("container"))

    def _relays(self) -> dict[str, str]:
        own = self._relay.address.removeprefix("relay:")
        return {self._engine.host: own} if own else self._engine.relays

    def _report_relays(self) -> None:
        relays = self._relays()
        if relays != self._reported_relays:
            self._reported_relays = relays
            self._send_report(ReportRelays(relays))

    def _hello(self) -> Hello:
        self._reported_relays = self._relays()
        return Hello(
            role="container",
            name=self._name,
            token=self._credential.secret,
            credential=self._credential.own,
            version=version("rce"),
            incarnation=self._incarnation,
            host=self._engine.host,
            sockets=self._engine.sockets,
            relays=self._reported_relays,
            capacity=self._engine.capacity,
            features=sorted(self._engine.features),
            gpus=self._engine.gpus,
            not_enforced=self._engine.not_enforced,
            environments={name: each.run for name, each in self._engine.running().items()},
        )

    async def _start(self, call: StartEnvironment) -> Nothing:
        spec = call.environment
        self._starting[spec.run] = spec.name
        began = time.perf_counter()
        try:
            await self._packages.provide(spec.run, [] if self._engine.fetches_packages else spec.packages)
            if spec.run in self._stopped:  # while its packages were fetched: the engine did not know of it
                raise StartFailed(f"environment {spec.name} was stopped while it started")
            await self._engine.start(spec)
        except RceError as error:
            log.warn("{name} did not start: {error}", name=spec.name, run=spec.run, error=str(error))
            raise
        finally:
            self._starting.pop(spec.run, None)
            self._stopped.discard(spec.run)
            await self._release()
        _launches.labels().observe_since(began)
        log.info("started {name}", name=spec.name, run=spec.run)
        return Nothing()

    async def _stop(self, call: StopEnvironment) -> Nothing:
        self._stopped.update(run for run, name in self._starting.items() if name == call.name)
        await self._engine.stop(call.name)
        await self._release()
        log.info("stopped {name}", name=call.name)
        return Nothing()

    async def _keep(self, call: KeepEnvironments) -> Nothing:
        await self._engine.keep(call.runs)
        await self._release()
        return Nothing()

    async def _know(self, call: SetRelays) -> Nothing:
        self._relay.set_relays(call.relays)
        self._engine.set_relays(call.relays)
        return Nothing()

    def _refuse_removed(self, call: SetRemovedMachines) -> None:
        if self._tls is not None:
            self._tls.set_removed(call.machines)
        self._engine.set_removed_machines(call.machines)

    async def _measure(self, _: MeasureUsage) -> Usage:
        return Usage(await self._engine.usage())

    async def _read_metrics(self, _: ReadMetrics) -> Metrics:
        used, parts = await asyncio.gather(self._engine.usage(), self._engine.metrics())
        own = metrics.collect_families("container", self._relay.families, lambda: self._families(used))
        return Metrics(metrics.merge_families(own, "node", parts) if parts else own)

    def _families(self, used: dict[str, EnvironmentUsage]) -> list[metrics.Family]:
        slots = sum(each.size for each in self._engine.running().values())
        sizes: dict[tuple[str, ...], float] = {("used",): slots, ("free",): self._engine.capacity - slots}
        names = ["user", "environment"]
        seconds = {tuple(name.split("/")): each.seconds for name, each in used.items()}
        memory = {tuple(name.split("/")): each.memory for name, each in used.items()}
        return [
            metrics.gauge_family("rce_slots", "Slots of this machine", ["state"], sizes),
            metrics.counter_family("rce_environment_cpu_seconds", "Processor time of an environment", names, seconds),
            metrics.gauge_family("rce_environment_memory_bytes", "Memory of an environment", names, memory),
        ]

    async def _release(self) -> None:
        """Release packages that no environment uses any more."""
        running = {each.run for each in self._engine.running().values()}
        await self._packages.release(running | set(self._starting))

    def _ended(self, ended: EnvironmentEnded) -> None:
        reason = "\n".join([ended.reason, *ended.lines])
        log.warn("{name}: {reason}", name=ended.name, run=ended.run, reason=reason)
        self._send_report(EnvironmentDied(ended.name, ended.run, reason))

    def _limit_hit(self, name: str, run: str, reason: str) -> None:
        log.info("{name}: {reason}", name=name, run=run, reason=reason)
        self._send_report(LimitReached(name, run, reason))

    def _send_report(self, call: EnvironmentDied | LimitReached | ReportRelays) -> None:
        report = asyncio.create_task(self._report(call))
        self._reports.add(report)
        report.add_done_callback(self._reports.discard)

    async def _report(self, call: EnvironmentDied | LimitReached | ReportRelays) -> None:
        try:
            await self._link.call(call)
        except RceError as error:
            # When this task set joins again, the Master learns it by the Hello: a run that ended is missing there.
            log.info("{call} was not sent to the Master: {error}", call=type(call).__name__, error=str(error))

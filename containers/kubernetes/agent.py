"""`python -P -m containers.kubernetes.agent`: the agent on each node of a cluster, in the node's network.

The engine knows the pods from Kubernetes and tells the agent which of them run on its node. The agent confines each one
from outside, as far as a pod's specification cannot, and then serves its sockets. It has no access to Kubernetes' API.
A record of each environment is on the node, so an agent that is restarted serves them again without being told.
"""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Annotated, Any, TypeVar
from weakref import WeakValueDictionary

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.agents.hosts import hosts
from containers.agents.node import NodeServices, NodeSettings
from containers.agents.outside_limits import LimitRequest, apply
from containers.docker import disks
from containers.endpoint import environment_user
from containers.engine import RUN
from containers.kubernetes import network, process, seccomp
from containers.kubernetes.places import Places
from containers.kubernetes.setup import SECCOMP
from containers.packages import PackageCache
from rce.control.calls.agents import ConnectGroup, Furnish, NodeReport, RemovedRun, RemoveRun
from rce.control.calls.call import Nothing
from rce.control.calls.watching import EnvironmentUsage, MeasureUsage, Usage
from rce.errors import MALFORMED, NotFound, StartFailed
from rce.process import loop
from rce.process.metrics import Family, gauge_family
from rce.process.settings import load_or_exit
from rce.protocol.slots import PIDS

PROGRAM = "rce agent"
HOSTS = "127.0.0.1\tlocalhost\n::1\tlocalhost ip6-localhost ip6-loopback\n"
log = Logger()
R = TypeVar("R")


class Settings(NodeSettings, frozen=True, kw_only=True):
    """RCE agent: serves the environments of one node of a Kubernetes cluster. The task set starts it."""

    address: Annotated[str, Meta(description="address of this node")]
    root: Annotated[Path, Meta(description="directory of the task set on this node")]
    seccomp: Annotated[Path, Meta(description="kubelet's directory of profiles of system calls")] = Path(SECCOMP)


class Record(Struct, frozen=True):
    """Record of an environment that is served, for the next agent."""

    call: Furnish
    process: int


class Agent:
    """Serves the environments of one node for its task set."""

    def __init__(self, reactor: ReactorBase, settings: Settings) -> None:
        self._settings = settings
        self._places = Places(settings.root)
        self._records: dict[str, Record] = {}  # by run
        self._furnishing: dict[str, asyncio.Task[None]] = {}  # by run
        self._connecting: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # by run
        self._services = NodeServices(reactor, settings, self._welcomed, self._families)
        self._reporting: set[asyncio.Task[None]] = set()
        handlers = self._services.handlers
        handlers.on(Furnish, self._furnish)
        handlers.on(RemoveRun, self._remove_run)
        handlers.on(ConnectGroup, self._connect_group)
        handlers.on(MeasureUsage, self._measure_usage)

    async def run(self) -> None:
        """Serve until cancelled or refused by the task set, whose error is then raised."""
        await asyncio.to_thread(seccomp.install, self._settings.seccomp)
        await self._services.listen(self._settings.address)
        try:
            await self._recover()
            await self._services.link.run()
        finally:
            await self._services.close()

    def _welcomed(self) -> None:
        self._spawn(self._services.notify(NodeReport(sorted(self._records), {}, True, self._services.relay)))

    async def _recover(self) -> None:
        """Serve what the agent before has served, and remove what it has left half-done."""
        self._places.runs.mkdir(parents=True, exist_ok=True)
        for directory in self._places.runs.iterdir():
            try:
                record = msgspec.json.decode(self._places.record(directory.name).read_bytes(), type=Record)
            except (FileNotFoundError, *MALFORMED):
                continue  # the task set will have it furnished, or removed
            if process.is_alive(record.process, record.call.container):
                await self._serve(record)

    async def _serve(self, record: Record) -> None:
        spec = record.call.environment
        socket = self._places.socket(spec.name, spec.run)
        await self._services.serve(spec.name, spec.run, self._places.control(spec.run), socket)
        self._records[spec.run] = record

    # --- calls of the task set ----------------------------------------------------------------------------------------

    async def _furnish(self, call: Furnish) -> Nothing:
        run = call.environment.run
        if not RUN.fullmatch(run):
            raise StartFailed(f"run {run[:80]!r} is not 32 hex digits")
        if run not in self._furnishing:
            task = self._furnishing[run] = asyncio.create_task(self._provide(call))
            task.add_done_callback(lambda _: self._furnishing.pop(run))
        try:
            await asyncio.shield(self._furnishing[run])
        except OSError as error:
            raise StartFailed(f"environment {call.environment.name} did not start: {error}") from None
        return Nothing()

    async def _provide(self, call: Furnish) -> None:
        """Confine an environment, provide what it asks for, and then open its sockets, unless that was done before."""
        spec = call.environment
        if spec.run in self._records:
            return
        first = await self._in_thread(lambda: process.first_process(call.container))
        await self._in_thread(lambda: self._confine(first, call))
        if spec.packages:
            cache = PackageCache(self._places.packages(spec.run), self._services.fetcher.fetch)
            cache.open()
            await cache.provide(spec.run, spec.packages)
            self._places.packages(spec.run).chmod(0o755)
        record = Record(call, first)
        self._places.record(spec.run).write_bytes(msgspec.json.encode(record))
        await self._serve(record)

    def _confine(self, first: int, call: Furnish) -> None:
        spec, options = call.environment, call.environment.options
        owner = environment_user(spec.name)
        network.confine(first, spec.egress, spec.group)
        process.limit(first, options.pids or PIDS * options.size, owner, call.memory)
        if spec.group is not None:
            self._places.hosts(spec.run).write_text(hosts(HOSTS, spec.group.subnet, spec.group.members))
        request = LimitRequest(first, str(self._places.root), options.bandwidth, options.io, options.disk)
        if not request.is_empty:
            apply(replace(request, disk_file=str(self._places.disk(spec.run)), owner=owner))

    async def _remove_run(self, call: RemoveRun) -> RemovedRun:
        """Close the sockets of an environment, whose pod is gone, and remove its directory."""
        if not RUN.fullmatch(call.run):
            raise NotFound(f"run {call.run[:80]!r} is not 32 hex digits")
        if call.run in self._furnishing:
            self._furnishing[call.run].cancel()
            await asyncio.wait({self._furnishing[call.run]})
        self._services.stop_serving(call.run)
        found = self._records.pop(call.run, None) is not None
        await self._in_thread(lambda: self._remove_directory(call.run))
        return RemovedRun(found)

    def _remove_directory(self, run: str) -> None:
        directory = self._places.runs / run
        if directory.exists():
            disks.sweep(directory)
            _make_writable(self._places.packages(run))
            shutil.rmtree(directory)

    async def _connect_group(self, call: ConnectGroup) -> Nothing:
        turn = self._connecting.setdefault(call.run, asyncio.Lock())
        async with turn:  # an earlier call may still be carried out, although nobody waits for its answer any more
            record = self._records.get(call.run)
            if record is None or record.call.environment.group is None:
                raise NotFound(f"run {call.run} is not served here, or is in no group")
            spec, group = record.call.environment, record.call.environment.group
            self._places.hosts(call.run).write_text(hosts(HOSTS, group.subnet, call.members))  # in place: it is mounted
            await self._in_thread(lambda: network.connect(record.process, spec.egress, group, call.peers))
        return Nothing()

    async def _measure_usage(self, _: MeasureUsage) -> Usage:
        records = list(self._records.values())
        found = await asyncio.gather(*(asyncio.to_thread(process.used, each.process) for each in records))
        usage: dict[str, EnvironmentUsage] = {}
        for record, used in zip(records, found, strict=True):
            if used is not None:
                usage[record.call.environment.name] = used
        return Usage(usage)

    def _families(self) -> list[Family]:
        here: dict[tuple[str, ...], float] = {
            ("served",): len(self._records),
            ("furnished",): len(self._furnishing),
        }
        return [gauge_family("rce_environments_here", "Environments of this node by state", ["state"], here)]

    async def _in_thread(self, work: Callable[[], R]) -> R:
        """Run `work` in a thread to its end; a cancellation is raised after that."""
        future = asyncio.get_running_loop().run_in_executor(None, work)
        try:
            return await asyncio.shield(future)
        except asyncio.CancelledError:
            await asyncio.wait([future])
            if not future.cancelled() and (error := future.exception()):
                log.info("a cancelled step failed: {error}", error=str(error))
            raise

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._reporting.add(task)
        task.add_done_callback(self._reporting.discard)


def _make_writable(directory: Path) -> None:
    """Make a tree of packages removable, which are read-only."""
    for each in (directory, *directory.rglob("*")):
        if each.is_dir() and not each.is_symlink():
            each.chmod(0o700)


def main() -> int:
    """Run the agent; return its exit status."""
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: Agent(reactor, settings).run())


if __name__ == "__main__":
    sys.exit(main())

"""The Environment endpoint: carries out what the Master asks for, and reports what happens."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from twisted.logger import Logger

from endpoints.data_port import DataPort
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.graph import read
from endpoints.environment.interfaces import RosInterface, Surroundings
from endpoints.environment.live import LiveParameters
from endpoints.environment.nodelog import NodeLog
from endpoints.environment.nodes import Nodes
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters, checked
from endpoints.environment.ros import RosThread
from endpoints.environment.services import ServiceClientInterface, ServiceProviderInterface
from endpoints.environment.settings import Settings
from endpoints.environment.surroundings import for_nodes, prefixes
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from endpoints.interface import Interface
from endpoints.switchboard import Switchboard
from rce.calls.call import Call, Nothing, Settled
from rce.calls.endpoints import (
    DropParameter,
    InterfaceSpec,
    LinkLost,
    NodeSpec,
    ParameterSpec,
    PutParameter,
    Report,
    StartNode,
    StopNode,
    Sync,
)
from rce.calls.robots import Definitions, Describe
from rce.calls.watching import Log, ReadGraph, ReadLog, RosGraph
from rce.control import Handlers
from rce.errors import ErrorInfo, InvalidRequest, RceError
from rce.metrics import Family, gauge

KINDS: dict[str, type[RosInterface]] = {
    "PublisherInterface": PublisherInterface,
    "SubscriberInterface": SubscriberInterface,
    "ServiceClientInterface": ServiceClientInterface,
    "ServiceProviderInterface": ServiceProviderInterface,
}
TICK = 1.0

log = Logger()
Tell = Callable[[Call[Nothing]], None]


class Environment:
    """What one environment has. `tell` sends a call to the Master, whenever that is there; what this process itself has
    to say is in `log`.
    """

    def __init__(self, settings: Settings, ros: RosThread, port: DataPort, tell: Tell, log: NodeLog) -> None:
        installed = prefixes(settings)
        packages = Packages(installed, settings.package_path)
        self._tell = tell
        self._log = log
        self._ros = ros
        self._definitions = InstalledTypes(installed + packages.prefixes, packages.sources)
        self._parameters = Parameters()
        self._live = LiveParameters(ros)
        self._nodes = Nodes(settings.data_dir, packages, self._parameters, for_nodes(settings), tell)
        self._switchboard = Switchboard(port, lambda link, reason: tell(LinkLost(link, reason)))
        self._around = Surroundings(ros, self._switchboard.watch, self._definitions, self._report)
        self._drops: dict[str, int] = {}

    def handlers(self) -> Handlers:
        """What this process answers to the Master."""
        handlers, board, nodes = Handlers(), self._switchboard, self._nodes
        handlers.on(Sync, self._sync)
        board.add_to(handlers, self._make)
        handlers.do(StartNode, lambda call: nodes.start(call.node))
        handlers.do(StopNode, lambda call: nodes.stop(call.node))
        handlers.do(PutParameter, lambda call: self._put(call.parameter))
        handlers.do(DropParameter, lambda call: self._parameters.drop(call.key))
        handlers.on(ReadLog, self._read_log)
        handlers.on(Describe, self._describe)
        handlers.on(ReadGraph, self._read_graph)
        handlers.tell_metrics("environment", board.families, self._families)
        return handlers

    async def run(self) -> None:
        """What happens every second, until it is cancelled; then everything is stopped."""
        try:
            while True:
                await asyncio.sleep(TICK)
                self._tick(time.monotonic())
        finally:
            await self._nodes.stop_all()
            await self._ros.stop()

    # calls

    async def _make(self, spec: InterfaceSpec) -> Interface:
        kind = KINDS.get(spec.kind)
        if kind is None:
            raise InvalidRequest(
                f"interface {spec.tag}: an environment has no {spec.kind}; it has {', '.join(KINDS)}",
                field="interfaceType",
            )
        interface = kind(spec, self._around)
        await interface.open()
        return interface

    async def _sync(self, call: Sync) -> Settled:
        failed = await self._sync_parameters(call.parameters)
        starting = asyncio.gather(*(self._start(spec, failed) for spec in call.nodes))
        for tag in set(self._nodes.specs) - {spec.tag for spec in call.nodes}:
            await self._nodes.stop(tag)
        failed |= await self._switchboard.sync(call, self._make)
        await starting
        return Settled(failed)

    async def _sync_parameters(self, specs: list[ParameterSpec]) -> dict[str, ErrorInfo]:
        failed: dict[str, ErrorInfo] = {}
        for key in set(self._parameters.specs) - {spec.key for spec in specs}:
            self._parameters.drop(key)
        for spec in specs:
            try:
                await self._put(spec)
            except RceError as error:
                failed[f"parameter:{spec.key}"] = error.info
        return failed

    async def _start(self, spec: NodeSpec, failed: dict[str, ErrorInfo]) -> None:
        try:
            await self._nodes.start(spec)
        except RceError as error:
            failed[f"node:{spec.tag}"] = error.info

    async def _put(self, spec: ParameterSpec) -> None:
        spec = checked(self._nodes.resolved(spec))
        before = self._parameters.specs.get(spec.key)
        if before == spec:
            return
        self._parameters.put(spec)
        if not self._nodes.specs:
            return
        young = self._nodes.young()
        try:
            await self._live.put(spec, young & {spec.node} if spec.node else young)
        except InvalidRequest:
            self._parameters.drop(spec.key)
            if before is not None:
                self._parameters.put(before)
            raise

    async def _read_log(self, call: ReadLog) -> Log:
        log = self._nodes.log(call.node) if call.node else self._log
        if call.after:
            return Log(*await log.more(call.after, call.wait))
        return Log(log.last_lines(call.lines), log.end)

    async def _describe(self, call: Describe) -> Definitions:
        return Definitions(self._definitions.describe(call.type, call.service))

    async def _read_graph(self, call: ReadGraph) -> RosGraph:
        return await self._ros.run(lambda: read(self._ros.node))

    def _families(self) -> list[Family]:
        return [gauge("rce_nodes", "Nodes that run", [], {(): len(self._nodes.specs)})]

    # reports

    def _report(self, spec: InterfaceSpec, error: RceError) -> None:
        self._tell(Report(spec.owner, spec.tag, error.info))

    def _tick(self, now: float) -> None:
        for interface in list(self._switchboard.interfaces.values()):
            assert isinstance(interface, RosInterface)
            interface.tick(now)
            if interface.dropped > self._drops.get(interface.spec.id, 0):
                self._drops[interface.spec.id] = interface.dropped
                self._tell(Report(interface.spec.owner, interface.spec.tag, drops=interface.dropped))
        present = {interface.spec.id for interface in self._switchboard.interfaces.values()}
        self._drops = {id: count for id, count in self._drops.items() if id in present}

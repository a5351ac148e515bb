"""The Environment endpoint: executes the calls of the Master, and reports errors and dropped messages."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable

from twisted.logger import Logger

from endpoints.data.interface import Interface
from endpoints.data.port import DataPort
from endpoints.data.switchboard import Switchboard
from endpoints.environment.action_client import ActionClientInterface
from endpoints.environment.action_provider import ActionProviderInterface
from endpoints.environment.dead_participants import tell_of_dead
from endpoints.environment.dead_ports import lock_dead_ports
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.live_parameters import LiveParameters
from endpoints.environment.nodes import Nodes
from endpoints.environment.output_log import OutputLog
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters, validate
from endpoints.environment.prepared_node import Spare
from endpoints.environment.process_environment import LOOPBACK, install_prefixes, node_variables
from endpoints.environment.recorders import Recorders
from endpoints.environment.ros import Ros
from endpoints.environment.ros_graph import read_graph
from endpoints.environment.secrets import Secrets
from endpoints.environment.services import ServiceClientInterface, ServiceProviderInterface
from endpoints.environment.settings import Settings
from endpoints.environment.topics import PublisherInterface, SubscriberInterface
from rce.control.calls.call import BatchResult, Call, Nothing
from rce.control.calls.endpoints import (
    MAX_TEXT,
    DropParameter,
    InterfaceSpec,
    Launched,
    LinkLost,
    NodeDied,
    NodeSpec,
    ParameterSpec,
    PutParameter,
    PutSecrets,
    Report,
    StartNode,
    StartRecorder,
    StopNode,
    StopRecorder,
    Sync,
)
from rce.control.calls.robots import Definitions, DescribeType
from rce.control.calls.watching import (
    Asset,
    Log,
    ReadAsset,
    ReadGraph,
    ReadLog,
    ReadPackages,
    RosGraph,
    RosPackage,
    RosPackages,
)
from rce.control.connection import Handlers
from rce.errors import ErrorInfo, InvalidRequest, LimitExceeded, RceError
from rce.process.metrics import Family, gauge_family

KINDS: dict[str, type[RosInterface]] = {
    "PublisherInterface": PublisherInterface,
    "SubscriberInterface": SubscriberInterface,
    "ServiceClientInterface": ServiceClientInterface,
    "ServiceProviderInterface": ServiceProviderInterface,
    "ActionClientInterface": ActionClientInterface,
    "ActionProviderInterface": ActionProviderInterface,
}
TICK = 1.0  # seconds
PORTS_LOCKED = 30.0  # seconds for which the ports of killed nodes are not used again
MAX_ASSET, ASSET_PIECE = 64 * 1024 * 1024, 512 * 1024  # bytes of a file of a package, and of one answer

log = Logger()
ReportCall = Callable[[Call[Nothing]], None]


class Environment:
    """Interfaces, nodes and parameters of one environment."""

    def __init__(
        self,
        settings: Settings,
        ros: Ros,
        port: DataPort,
        report: ReportCall,
        log: OutputLog,
        internal_log: OutputLog,
        spare: Spare | None = None,
    ) -> None:
        """Create an empty environment.

        Args:
            settings: Settings of the process.
            ros: The ROS node, which `run` stops at the end.
            port: Data port of the process.
            report: Sends a call to the Master as soon as it can be reached.
            log: Log of what concerns users.
            internal_log: Log of everything in this process, as the Master's calls.
            spare: Interpreter that may become the first node.
        """
        installed = install_prefixes(settings)
        packages = Packages(installed, settings.package_path)
        self._packages = packages
        self._send_report = report
        self._log = log
        self._internal_log = internal_log
        self._ros = ros
        self._definitions = InstalledTypes(installed + packages.prefixes, packages.sources)
        self._parameters = Parameters()
        variables = node_variables(settings)
        self._secrets = Secrets(settings.run, variables)
        self._nodes = Nodes(settings.data_dir, packages, self._parameters, variables, self._of_nodes, spare)
        self._live_parameters = LiveParameters(ros, self._nodes.enclave)
        self._switchboard = Switchboard(port, lambda link, reason: report(LinkLost(link, reason[:MAX_TEXT])))
        self._context = RosContext(ros, self._switchboard.hops, self._definitions, self._report_error)
        self._recorders = Recorders(self._context, settings.recordings, self._read_topics, report)
        self._hosts = list(filter(None, [LOOPBACK, settings.address, *settings.peers]))
        self._reported_drops: dict[str, int] = {}  # by interface id

    def handlers(self) -> Handlers:
        """Return the handlers of the Master's calls."""
        handlers, board, nodes = Handlers(), self._switchboard, self._nodes
        handlers.on(Sync, self._sync)
        board.add_to(handlers, self._make_interface)
        handlers.do(StartNode, lambda call: nodes.start(call.node))
        handlers.do(StopNode, lambda call: nodes.stop(call.node))
        handlers.do(PutSecrets, lambda call: self._secrets.put(call.secrets))
        handlers.do(PutParameter, lambda call: self._put(call.parameter))
        handlers.do(DropParameter, lambda call: self._parameters.drop(call.key))
        handlers.do(StartRecorder, lambda call: self._recorders.start(call.recorder))
        handlers.do(StopRecorder, lambda call: self._recorders.stop(call.recorder))
        handlers.on(ReadLog, self._read_log)
        handlers.on(DescribeType, self._describe)
        handlers.on(ReadGraph, self._read_graph)
        handlers.on(ReadPackages, self._read_packages)
        handlers.on(ReadAsset, self._read_asset)
        handlers.serve_metrics("environment", board.families, self._families)
        return handlers

    async def run(self) -> None:
        """Run until cancelled; then stop all nodes and ROS."""
        try:
            while True:
                await asyncio.sleep(TICK)
                self._tick(time.monotonic())
        finally:
            await asyncio.gather(self._nodes.stop_all(), self._recorders.stop_all())
            self._secrets.remove()
            for link in list(self._switchboard.links):  # what came over them now would find no ROS
                self._switchboard.close_link(link)
            self._ros.close()

    # calls

    async def _make_interface(self, spec: InterfaceSpec) -> Interface:
        kind = KINDS.get(spec.kind)
        if kind is None:
            raise InvalidRequest(
                f"interface {spec.tag}: an environment has no {spec.kind}; use one of {', '.join(KINDS)}",
                field="interfaceType",
            )
        interface = kind(spec, self._context)
        await interface.open()
        return interface

    async def _sync(self, call: Sync) -> BatchResult:
        failed = await self._sync_parameters(call.parameters)
        starting = asyncio.gather(*(self._start(spec, failed) for spec in call.nodes))
        for tag in set(self._nodes.specs) - {spec.tag for spec in call.nodes}:
            await self._nodes.stop(tag)
        failed |= await self._switchboard.sync(call, self._make_interface)
        failed |= await self._recorders.sync(call.recorders)
        await starting
        return BatchResult(failed)

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
        spec = validate(self._nodes.resolve(spec))
        before = self._parameters.specs.get(spec.key)
        if before == spec:
            return
        self._parameters.put(spec)
        if not self._nodes.specs:
            return
        starting = self._nodes.starting()
        try:
            await self._live_parameters.put(spec, starting & {spec.node} if spec.node else starting)
        except InvalidRequest:
            self._parameters.drop(spec.key)
            if before is not None:
                self._parameters.put(before)
            raise

    async def _read_log(self, call: ReadLog) -> Log:
        own = self._internal_log if call.verbose else self._log
        log = self._nodes.log(call.node) if call.node else own
        if call.after:
            return Log(*await log.wait_since(call.after, call.wait))
        return Log(log.last_lines(call.lines), log.end)

    async def _describe(self, call: DescribeType) -> Definitions:
        return Definitions(self._definitions.describe(call.type, call.sort))

    async def _read_graph(self, call: ReadGraph) -> RosGraph:
        return read_graph(self._ros.node)

    async def _read_topics(self) -> dict[str, str]:
        found = self._ros.node.get_topic_names_and_types()
        return {name: types[0] for name, types in found}

    async def _read_asset(self, call: ReadAsset) -> Asset:
        return await asyncio.to_thread(self._asset, call)

    def _asset(self, call: ReadAsset) -> Asset:
        with self._packages.asset(call.package, call.path).open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            if size > MAX_ASSET:
                raise LimitExceeded(f"{call.path[:200]} has {size} bytes; files may have {MAX_ASSET}", limit=MAX_ASSET)
            file.seek(call.offset)
            return Asset(file.read(ASSET_PIECE), size)

    async def _read_packages(self, call: ReadPackages) -> RosPackages:
        found = await asyncio.to_thread(self._packages.executables)
        return RosPackages([RosPackage(name, executables) for name, executables in found.items()])

    def _families(self) -> list[Family]:
        return [gauge_family("rce_nodes", "Nodes that run", [], {(): len(self._nodes.processes)})]

    # reports

    def _of_nodes(self, report: NodeDied | Launched) -> None:
        if isinstance(report, NodeDied):
            self._tell_of_dead()
        self._send_report(report)

    def _tell_of_dead(self) -> None:
        self._ros.call_later(PORTS_LOCKED, lock_dead_ports().close)
        tell_of_dead(self._ros.node, self._ros.prefix, self._hosts)

    def _report_error(self, spec: InterfaceSpec, error: RceError) -> None:
        self._send_report(Report(spec.owner, spec.tag, error.info))

    def _tick(self, now: float) -> None:
        for interface in list(self._switchboard.interfaces.values()):
            assert isinstance(interface, RosInterface)
            interface.tick(now)
            if interface.dropped > self._reported_drops.get(interface.spec.id, 0):
                self._reported_drops[interface.spec.id] = interface.dropped
                self._send_report(Report(interface.spec.owner, interface.spec.tag, drops=interface.dropped))
        present = {interface.spec.id for interface in self._switchboard.interfaces.values()}
        self._reported_drops = {id: count for id, count in self._reported_drops.items() if id in present}

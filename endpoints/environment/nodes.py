"""Nodes and launches of an environment, by their tags."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.arguments import enclave, ros_arguments, split, substitute
from endpoints.environment.launch.evaluation import evaluate, launch_arguments, node_spec, tags
from endpoints.environment.launch.group import LaunchGroup, Member
from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters
from endpoints.environment.prepared_node import ENCLAVE, Spare
from endpoints.environment.process_environment import user_node_variables
from rce.control.calls.endpoints import Launched, NodeDied, NodeSpec, ParameterSpec
from rce.errors import NotFound, StartFailed, disk_full
from rce.spelling import did_you_mean

log = Logger()
LAST_LINES = 20
START_TIMEOUT = 5.0  # seconds within which a ROS node appears in the ROS graph


class Nodes:
    """Starts and stops nodes and launches; `report` gets those that end by themselves, and the nodes of launches.

    The first node that comes with RCE takes the process of `spare`.
    """

    def __init__(
        self,
        directory: Path,
        packages: Packages,
        parameters: Parameters,
        variables: dict[str, str],
        report: Callable[[NodeDied | Launched], None],
        spare: Spare | None = None,
    ) -> None:
        self._spare = spare or Spare()
        self._directory = directory
        self._packages = packages
        self._parameters = parameters
        self._variables = variables
        self._report = report
        self._running: dict[str, NodeProcess] = {}
        self._launches: dict[str, LaunchGroup] = {}
        self._logs: dict[str, OutputLog] = {}
        self._locks: dict[str, asyncio.Lock] = {}

    @property
    def specs(self) -> dict[str, NodeSpec]:
        """Running nodes and launches by tag; the nodes of launches are not among them."""
        return {tag: node.spec for tag, node in self._running.items()} | {
            tag: group.spec for tag, group in self._launches.items()
        }

    @property
    def processes(self) -> dict[str, NodeProcess]:
        """Processes of all nodes by tag."""
        return self._running | {tag: node for each in self._launches.values() for tag, node in each.running.items()}

    def starting(self) -> set[str]:
        """Return the tags of nodes that may have read their parameters but not yet appeared in the ROS graph."""
        youngest = time.monotonic() - START_TIMEOUT
        return {tag for tag, node in self.processes.items() if node.started > youngest}

    def enclave(self, tag: str) -> str:
        """Return the enclave in the ROS graph of the node with this tag."""
        node = self.processes.get(tag)
        return node.enclave if node else enclave(tag)

    async def start(self, spec: NodeSpec) -> None:
        """Start a node or launch unless it runs already; one with the same tag and another spec is replaced.

        Raises:
            NotFound: The package or its executable or launch file does not exist.
            InvalidRequest: The arguments are malformed, or the launch file is wrong.
            StartFailed: The command cannot be executed.
        """
        async with self._lock(spec.tag):
            if self.specs.get(spec.tag) == spec:
                if spec.tag in self._launches:
                    self._launches[spec.tag].tell()  # a Master that has restarted may not know its nodes
                return
            await self._stop(spec.tag)
            try:
                await (self._launch(spec) if spec.launch else self._start(spec))
            except OSError as error:
                raise StartFailed(f"node {spec.tag} did not start: {disk_full(error) or error}") from None

    async def _start(self, spec: NodeSpec) -> None:
        variables = self._variables_of(spec)
        command = self._packages.command(spec.pkg, spec.exe)
        given = split(substitute(spec.args, self._packages, variables))
        spare = self._spare if self._packages.is_shipped(spec.pkg) else None
        self._running[spec.tag] = await self._run(spec, command, given, variables, self._ended, spare)
        log.info("node {node} started: {pkg} {exe}", node=spec.tag, pkg=spec.pkg, exe=spec.exe)

    async def _run(
        self,
        spec: NodeSpec,
        command: list[str],
        given: list[str],
        variables: dict[str, str],
        ended: Callable[[NodeProcess, int], None],
        spare: Spare | None = None,
    ) -> NodeProcess:
        directory = self._directory_of(spec.tag)
        parameters = directory / "parameters.yaml"
        if spare is not None and not spare.suits(command, variables):
            spare = None
        command = command + given + ros_arguments(spec, given, parameters, ENCLAVE if spare else "")
        self._parameters.write(spec.tag, parameters)
        output = self._logs[spec.tag] = OutputLog(directory / "output.log")
        return await NodeProcess.start(spec, command, variables, self._directory / "home", output, ended, spare)

    async def _launch(self, spec: NodeSpec) -> None:
        file = self._packages.launch_file(spec.pkg, spec.launch)
        arguments = launch_arguments(split(substitute(spec.args, self._packages, self._variables)))
        directory = self._directory_of(spec.tag)
        output = self._logs[spec.tag] = OutputLog(directory / "output.log")
        shares = {name: str(path) for name, path in (await asyncio.to_thread(self._packages.shares)).items()}
        home = self._directory / "home"
        found = await evaluate(spec, file, arguments, shares, self._variables, directory, home, output)
        members = [Member(node_spec(node, tag), node) for node, tag in zip(found, tags(found, spec.tag), strict=True)]
        group = self._launches[spec.tag] = LaunchGroup(spec, members, output, self._run_member, self._report)
        try:
            await group.start()
        except BaseException:
            del self._launches[spec.tag]
            raise
        group.over.add_done_callback(lambda done: self._launch_over(group, done.result()))
        log.info("launch {node} started: {pkg} {launch}", node=spec.tag, pkg=spec.pkg, launch=spec.launch)

    async def _run_member(self, member: Member, ended: Callable[[NodeProcess, int], None]) -> NodeProcess:
        spec, node = member.spec, member.node
        changed = self._variables_of(spec) | node.environment
        variables = {name: value for name, value in changed.items() if value is not None}
        command = self._packages.command(spec.pkg, spec.exe)
        given = node.command_arguments(self._directory_of(spec.tag))
        return await self._run(spec, command, given, variables, ended)

    def _launch_over(self, group: LaunchGroup, report: NodeDied) -> None:
        tag = group.spec.tag
        log.info("launch {node} ended with status {status}", node=tag, status=report.status)
        if self._launches.get(tag) is group:
            del self._launches[tag]
            self._report(report)

    def _variables_of(self, spec: NodeSpec) -> dict[str, str]:
        return self._variables if self._packages.is_shipped(spec.pkg) else user_node_variables(self._variables)

    def _directory_of(self, tag: str) -> Path:
        directory = self._directory / "nodes" / tag
        directory.mkdir(parents=True, exist_ok=True)
        return directory

    async def stop(self, tag: str) -> None:
        """Stop a node or launch, if it runs."""
        async with self._lock(tag):
            await self._stop(tag)

    async def _stop(self, tag: str) -> None:
        group = self._launches.pop(tag, None)
        if group is not None:
            await group.stop()
        node = self._running.get(tag)
        if node is not None:
            await node.stop()

    async def stop_all(self) -> None:
        """Stop all nodes and launches."""
        await asyncio.gather(*(self.stop(tag) for tag in self.specs))

    def log(self, tag: str) -> OutputLog:
        """Return the log of a node that runs or has ended; raise NotFound if it was never started."""
        output = self._logs.get(tag)
        if output is None:
            hint = did_you_mean(tag, self._logs) or "check the tag"
            raise NotFound(f"no node {tag[:80]} was started in this environment: {hint}", field="nodeTag")
        return output

    def resolve(self, parameter: ParameterSpec) -> ParameterSpec:
        """Return the parameter with the substitutions of `args` in a string value.

        Raises:
            InvalidRequest: A substitution is malformed.
            NotFound: A package does not exist.
        """
        if not isinstance(parameter.value, str):
            return parameter
        value = substitute(parameter.value, self._packages, self._variables, "value")
        return ParameterSpec(parameter.name, value, parameter.node)

    def _lock(self, tag: str) -> asyncio.Lock:
        return self._locks.setdefault(tag, asyncio.Lock())

    def _ended(self, node: NodeProcess, status: int) -> None:
        tag = node.spec.tag
        log.info("node {node} ended with status {status}", node=tag, status=status)
        if self._running.get(tag) is node:
            del self._running[tag]
        if not node.stopping:
            lines = node.output.last_lines(LAST_LINES)
            self._report(NodeDied(tag, status, lines, time.monotonic() - node.started))

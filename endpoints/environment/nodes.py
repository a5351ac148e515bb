"""Nodes of an environment, by their tags."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.arguments import ros_arguments, split, substitute
from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters
from endpoints.environment.process_environment import user_node_variables
from rce.control.calls.endpoints import NodeDied, NodeSpec, ParameterSpec
from rce.errors import NotFound, StartFailed, disk_full
from rce.spelling import did_you_mean

log = Logger()
LAST_LINES = 20
START_TIMEOUT = 5.0  # seconds within which a ROS node appears in the ROS graph


class Nodes:
    """Starts and stops nodes; `died` is called for each one that ends by itself."""

    def __init__(
        self,
        directory: Path,
        packages: Packages,
        parameters: Parameters,
        variables: dict[str, str],
        died: Callable[[NodeDied], None],
    ) -> None:
        self._directory = directory
        self._packages = packages
        self._parameters = parameters
        self._variables = variables
        self._died = died
        self._running: dict[str, NodeProcess] = {}
        self._logs: dict[str, OutputLog] = {}
        self._locks: dict[str, asyncio.Lock] = {}

    @property
    def specs(self) -> dict[str, NodeSpec]:
        """Running nodes by tag."""
        return {tag: node.spec for tag, node in self._running.items()}

    def starting(self) -> set[str]:
        """Return the tags of nodes that may have read their parameters but not yet appeared in the ROS graph."""
        youngest = time.monotonic() - START_TIMEOUT
        return {tag for tag, node in self._running.items() if node.started > youngest}

    async def start(self, spec: NodeSpec) -> None:
        """Start a node unless it runs already; one with the same tag and another spec is replaced.

        Raises:
            NotFound: The package or its executable does not exist.
            InvalidRequest: The arguments are malformed.
            StartFailed: The command cannot be executed.
        """
        async with self._lock(spec.tag):
            present = self._running.get(spec.tag)
            if present is not None:
                if present.spec == spec:
                    return
                await present.stop()
            try:
                await self._start(spec)
            except OSError as error:
                raise StartFailed(f"node {spec.tag} did not start: {disk_full(error) or error}") from None

    async def _start(self, spec: NodeSpec) -> None:
        shipped = self._packages.is_shipped(spec.pkg)
        variables = self._variables if shipped else user_node_variables(self._variables)
        command = self._packages.command(spec.pkg, spec.exe)
        given = split(substitute(spec.args, self._packages, variables))
        directory = self._directory / "nodes" / spec.tag
        directory.mkdir(parents=True, exist_ok=True)
        parameters = directory / "parameters.yaml"
        command += given + ros_arguments(spec, given, parameters)
        self._parameters.write(spec.tag, parameters)
        output = self._logs[spec.tag] = OutputLog(directory / "output.log")
        self._running[spec.tag] = await NodeProcess.start(
            spec, command, variables, self._directory / "home", output, self._ended
        )
        log.info("node {node} started: {pkg} {exe}", node=spec.tag, pkg=spec.pkg, exe=spec.exe)

    async def stop(self, tag: str) -> None:
        """Stop a node, if it runs."""
        async with self._lock(tag):
            node = self._running.get(tag)
            if node is not None:
                await node.stop()

    async def stop_all(self) -> None:
        """Stop all nodes."""
        await asyncio.gather(*(self.stop(tag) for tag in list(self._running)))

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
            self._died(NodeDied(tag, status, lines, time.monotonic() - node.started))

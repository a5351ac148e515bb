"""The nodes of an environment, by their tags."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.arguments import ros_arguments, split, substitute
from endpoints.environment.node import NodeProcess
from endpoints.environment.nodelog import NodeLog
from endpoints.environment.packages import Packages
from endpoints.environment.parameters import Parameters
from endpoints.environment.surroundings import for_users_nodes
from rce.calls.endpoints import NodeDied, NodeSpec, ParameterSpec
from rce.errors import NotFound

log = Logger()
LAST_LINES = 20
START = 5.0  # seconds in which a node has appeared in ROS, if it is one


class Nodes:
    """Starts and stops them; `died` is told of those that end by themselves."""

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
        self._logs: dict[str, NodeLog] = {}
        self._locks: dict[str, asyncio.Lock] = {}

    @property
    def specs(self) -> dict[str, NodeSpec]:
        return {tag: node.spec for tag, node in self._running.items()}

    def young(self) -> set[str]:
        """Tags of nodes that may have read their parameters, but need not have appeared in ROS."""
        youngest = time.monotonic() - START
        return {tag for tag, node in self._running.items() if node.started > youngest}

    async def start(self, spec: NodeSpec) -> None:
        """One that runs already stays; one of another spec is replaced. StartFailed, NotFound, InvalidRequest."""
        async with self._lock(spec.tag):
            present = self._running.get(spec.tag)
            if present is not None:
                if present.spec == spec:
                    return
                await present.stop()
            await self._start(spec)

    async def _start(self, spec: NodeSpec) -> None:
        shipped = self._packages.is_shipped(spec.pkg)
        variables = self._variables if shipped else for_users_nodes(self._variables)
        command = self._packages.command(spec.pkg, spec.exe)
        given = split(substitute(spec.args, self._packages, variables))
        directory = self._directory / "nodes" / spec.tag
        directory.mkdir(parents=True, exist_ok=True)
        parameters = directory / "parameters.yaml"
        command += given + ros_arguments(spec, given, parameters)
        self._parameters.write(spec.tag, parameters)
        output = self._logs[spec.tag] = NodeLog(directory / "output.log")
        self._running[spec.tag] = await NodeProcess.start(
            spec, command, variables, self._directory / "home", output, self._ended
        )
        log.info("node {node} is started: {pkg} {exe}", node=spec.tag, pkg=spec.pkg, exe=spec.exe)

    async def stop(self, tag: str) -> None:
        async with self._lock(tag):
            node = self._running.get(tag)
            if node is not None:
                await node.stop()

    async def stop_all(self) -> None:
        await asyncio.gather(*(self.stop(tag) for tag in list(self._running)))

    def log(self, tag: str) -> NodeLog:
        """Also of a node that has ended. NotFound."""
        output = self._logs.get(tag)
        if output is None:
            raise NotFound(f"no node {tag} was started in this environment", field="nodeTag")
        return output

    def resolved(self, parameter: ParameterSpec) -> ParameterSpec:
        """A parameter that is a string gets the substitutions of `args`. InvalidRequest, NotFound."""
        if not isinstance(parameter.value, str):
            return parameter
        value = substitute(parameter.value, self._packages, self._variables, "value")
        return ParameterSpec(parameter.name, value, parameter.node)

    def _lock(self, tag: str) -> asyncio.Lock:
        return self._locks.setdefault(tag, asyncio.Lock())

    def _ended(self, node: NodeProcess, status: int) -> None:
        tag = node.spec.tag
        log.info("node {node} has ended with status {status}", node=tag, status=status)
        if self._running.get(tag) is node:
            del self._running[tag]
        if not node.stopping:
            lines = node.output.last_lines(LAST_LINES)
            self._died(NodeDied(tag, status, lines, time.monotonic() - node.started))

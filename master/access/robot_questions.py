"""Questions of Robot endpoints about environments and robots, answered within the rights of who opened the session."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Protocol, TypeVar

from twisted.logger import Logger

from master.access import rights
from master.execution.command_executor import START_TIMEOUT
from master.graph.records import Environment, Process, Robot, user_of
from master.graph.state import State
from rce.control.calls.call import Call
from rce.control.calls.robots import (
    Definitions,
    DescribeType,
    ReadAssetFor,
    ReadGraphFor,
    ReadRobotsFor,
    RobotInterfaceName,
    RobotInterfaces,
)
from rce.control.calls.watching import Asset, ReadAsset, ReadGraph, RosGraph
from rce.control.connection import Handlers
from rce.errors import NotFound, RceError, UnknownType
from rce.protocol.names import is_guest

ANSWER_TIMEOUT = 5.0  # seconds for an environment that has started

log = Logger()
R = TypeVar("R")


class Ask(Protocol):
    """Makes a call at an environment, once it is ready; see `Master.ask`."""

    async def __call__(self, environment: Environment, call: Call[R]) -> R:
        """Return the answer."""


class RobotQuestions:
    """Answers the questions of Robot endpoints."""

    def __init__(self, state: State, ask: Ask) -> None:
        self._state = state
        self._ask = ask

    def add_handlers(self, handlers: Handlers, process: Process) -> None:
        """Answer the questions of a Robot endpoint."""
        handlers.on(DescribeType, self.describe_type)
        handlers.on(ReadGraphFor, lambda call: self._read_graph(process, call))
        handlers.on(ReadAssetFor, lambda call: self._read_asset(process, call))
        handlers.on(ReadRobotsFor, lambda call: self._read_robots(process, call))

    async def describe_type(self, call: DescribeType) -> Definitions:
        """Ask the user's environments, including those that are starting."""
        with suppress(TimeoutError):
            async with asyncio.timeout(START_TIMEOUT + ANSWER_TIMEOUT):
                for environment in self._state.environments.by(call.user):
                    try:
                        return await self._ask(environment, call)
                    except RceError as error:
                        name = environment.name
                        log.debug("{name} does not know {type}: {error}", name=name, type=call.type, error=error)
        raise UnknownType(f"type {call.type} is known neither here nor in an environment of {call.user}")

    async def _read_graph(self, process: Process, call: ReadGraphFor) -> RosGraph:
        """Ask an environment for its graph."""
        return await self._ask(self._environment_of(process, call), ReadGraph())

    async def _read_asset(self, process: Process, call: ReadAssetFor) -> Asset:
        """Ask an environment for a piece of a package's file."""
        question = ReadAsset(call.package, call.path, call.offset)
        return await self._ask(self._environment_of(process, call), question)

    def _environment_of(self, process: Process, call: ReadGraphFor | ReadAssetFor) -> Environment:
        """Return the environment of a question, within the rights of who opened the robot's session."""
        robot = self._robot_at(process, call.robot)
        owner = user_of(robot.name)
        rights.check(robot.by, "interface.read", owner, environment=call.environment)
        environment = self._state.environments.get(f"{owner}/{call.environment}")
        if environment is None:
            raise NotFound(f"there is no environment {call.environment[:80]!r}", field="containerTag")
        return environment

    async def _read_robots(self, process: Process, call: ReadRobotsFor) -> RobotInterfaces:
        """List the interfaces of robots, within the rights of who opened the robot's session."""
        asking = self._robot_at(process, call.robot)
        owner = user_of(asking.name)
        tags = (each.name.partition("/")[2] for each in self._state.robots.by(owner))
        seen = [tag for tag in tags if not is_guest(tag) and rights.may(asking.by, "interface.read", owner, robot=tag)]
        found = [
            RobotInterfaceName(tag, each.tag, each.kind, each.type)
            for tag in seen
            for each in self._state.interfaces.by(f"{owner}/{tag}")
        ]
        return RobotInterfaces(sorted(found, key=lambda each: (each.robot, each.tag)))

    def _robot_at(self, process: Process, name: str) -> Robot:
        robot = self._state.robots.get(name)
        if robot is None or robot.endpoint != process.name:
            raise NotFound(f"robot {name} has no session at {process.name}")
        return robot

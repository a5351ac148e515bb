"""The bridge at work: offloading starts and stops, and comes back by itself when the platform was away."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from twisted.logger import Logger

from endpoints.bridge.config import BridgeConfig
from endpoints.bridge.ends import LocalRos
from endpoints.bridge.flows import flows
from rce.client import Environment, Robot
from rce.client.session import delays
from rce.errors import AlreadyExists, NoCapacity, RceError, TimedOut, Unavailable
from rce.messages import CreateContainer, EnvironmentEvent, NodeEvent

PASSING = (Unavailable, TimedOut, NoCapacity)  # trying again may help

log = Logger()


class Offloading:
    """Keeps what is to be carried flowing while it is on."""

    def __init__(self, config: BridgeConfig, local: LocalRos) -> None:
        self.failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Gets the error for which trying again does not help."""
        self._config = config
        self._local = local
        self._task: asyncio.Task[None] | None = None
        self._carries = asyncio.Event()

    async def start(self) -> None:
        """Start unless it is on; returns when everything is carried. Raises why that cannot be."""
        if self._task is None:
            self._task = asyncio.create_task(self._keep_carrying())
        task = self._task
        carries = asyncio.create_task(self._carries.wait())
        await asyncio.wait([task, carries], return_when=asyncio.FIRST_COMPLETED)
        carries.cancel()
        if task.cancelled():
            raise Unavailable("offloading was stopped while it started")
        if task.done():
            self._task = None
            task.result()

    async def stop(self) -> None:
        """Carry nothing more; an environment that the bridge made is destroyed."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _keep_carrying(self) -> None:
        while True:
            self._carries.clear()
            for delay in delays():
                await asyncio.sleep(delay)
                try:
                    async with self._carrying() as robot:
                        log.info("all is carried to and from {tag}", tag=self._config.environment.tag)
                        self._carries.set()
                        await self._watch(robot)
                except PASSING as error:
                    log.warn("nothing is carried: {error}", error=str(error))
                except RceError as error:
                    if not self.failed.done():
                        self.failed.set_exception(error)
                    raise
                if self._carries.is_set():
                    break  # it has worked: the delays begin anew

    @contextlib.asynccontextmanager
    async def _carrying(self) -> AsyncIterator[Robot]:
        config = self._config
        async with contextlib.AsyncExitStack() as stack:
            robot = await stack.enter_async_context(
                Robot(
                    config.url,
                    user=config.user,
                    robot=config.robot,
                    password=config.password,
                    key=config.key,
                    compress=config.compress,
                )
            )
            environment = robot.environment(config.environment.tag)
            if config.environment.create is not None:
                await self._furnish(robot, stack)
            for flow in flows(config):
                stack.callback(flow.end)
                await flow.open(self._local, environment)
            yield robot

    async def _furnish(self, robot: Robot, stack: contextlib.AsyncExitStack) -> None:
        """Make the environment with what is to run in it; what an earlier life of this bridge left is used as it is."""
        wanted = self._config.environment
        assert wanted.create is not None
        with contextlib.suppress(AlreadyExists):
            await robot.configure(CreateContainer(wanted.tag, wanted.create))
        stack.push_async_callback(_destroy, robot.environment(wanted.tag))
        for name, value in wanted.parameters.items():
            await robot.set_parameter(wanted.tag, name, value)
        for node in wanted.nodes:
            with contextlib.suppress(AlreadyExists):
                await robot.add_node(
                    wanted.tag, node.tag, node.pkg, node.exe, args=node.args, name=node.name, namespace=node.namespace
                )

    async def _watch(self, robot: Robot) -> None:
        """Until the environment is gone, which ends with it what is carried."""
        async for event in robot.events():
            match event:
                case EnvironmentEvent(containerTag=tag, state="gone" | "failed", reason=reason) if (
                    tag == self._config.environment.tag
                ):
                    log.warn("environment {tag} is gone: {reason}", tag=tag, reason=reason)
                    return
                case NodeEvent(nodeTag=node, status=status, lines=lines):
                    log.warn(
                        "node {node} ended with status {status}: {lines}",
                        node=node,
                        status=status,
                        lines="\n".join(lines),
                    )
                case RceError():
                    log.warn("{error}", error=str(event))


async def _destroy(environment: Environment) -> None:
    try:
        await environment.destroy()
    except RceError as error:  # the platform is away, or it is gone already
        log.info("environment {tag} was not destroyed: {error}", tag=environment.tag, error=str(error))

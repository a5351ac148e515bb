"""Offloading: the flows between the robot's ROS and an environment, restored after the platform was unreachable."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from twisted.logger import Logger

from endpoints.bridge.config import BridgeConfig
from endpoints.bridge.flows import make_flows
from endpoints.bridge.local_ros import LocalRos
from rce.client import Environment, Robot
from rce.client.session import backoff_delays
from rce.errors import AlreadyExists, NoCapacity, RceError, TimedOut, Unavailable
from rce.protocol.messages import CreateContainer, EnvironmentEvent, NodeEvent

RETRIABLE = (Unavailable, TimedOut, NoCapacity)

log = Logger()


class Offloading:
    """Keeps all flows of a bridge open while it is on.

    Attributes:
        failed: Fails with the error of a rejected flow or command, which is not retried.
    """

    def __init__(self, config: BridgeConfig, local: LocalRos) -> None:
        self.failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._config = config
        self._local = local
        self._task: asyncio.Task[None] | None = None
        self._established = asyncio.Event()  # set while all flows are open

    async def start(self) -> None:
        """Start unless it is on; return when all flows are open.

        Raises:
            RceError: A flow or command was rejected.
        """
        if self._task is None:
            self._task = asyncio.create_task(self._run())
        task = self._task
        established = asyncio.create_task(self._established.wait())
        await asyncio.wait([task, established], return_when=asyncio.FIRST_COMPLETED)
        established.cancel()
        if task.cancelled():
            raise Unavailable("offloading was stopped while it started")
        if task.done():
            self._task = None
            task.result()

    async def stop(self) -> None:
        """Close all flows, and destroy the environment if the bridge created it."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            self._established.clear()
            for delay in backoff_delays():
                await asyncio.sleep(delay)
                try:
                    async with self._flows() as robot:
                        log.info("all flows to and from environment {tag} are open", tag=self._config.environment.tag)
                        self._established.set()
                        await self._watch_events(robot)
                except RETRIABLE as error:
                    log.warn("offloading is interrupted: {error}", error=str(error))
                except RceError as error:
                    if not self.failed.done():
                        self.failed.set_exception(error)
                    raise
                if self._established.is_set():
                    break  # it was established, so the delays begin anew

    @contextlib.asynccontextmanager
    async def _flows(self) -> AsyncIterator[Robot]:
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
                await self._create_environment(robot, stack)
            for flow in make_flows(config):
                stack.callback(flow.end)
                await flow.open(self._local, environment)
            yield robot

    async def _create_environment(self, robot: Robot, stack: contextlib.AsyncExitStack) -> None:
        """Create the environment with its parameters and nodes; those of an earlier run of the bridge are reused."""
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
                    wanted.tag,
                    node.tag,
                    node.pkg,
                    node.exe,
                    args=node.args,
                    name=node.name,
                    namespace=node.namespace,
                    launch=node.launch,
                )

    async def _watch_events(self, robot: Robot) -> None:
        """Log events of the platform; return when the environment, and with it all flows, is gone."""
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
    except RceError as error:  # the platform cannot be reached, or the environment is gone already
        log.info("environment {tag} was not destroyed: {error}", tag=environment.tag, error=str(error))

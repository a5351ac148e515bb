"""`rce gateway` for an environment with the action server of the tutorials."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

from rce.client import Environment
from tests.support.e2e.consoles import running, user_environ
from tests.support.e2e.real_platform import RealPlatform
from tests.support.e2e.traffic import call


class Gateway(NamedTuple):
    """URLs of the local ports, the environment as its owner uses it, and variables for `rce`."""

    rosbridge: str
    foxglove: str
    environment: Environment
    env: dict[str, str]


@asynccontextmanager
async def open_gateway(platform: RealPlatform, home: Path, tag: str, rosbridge_port: int = 0) -> AsyncIterator[Gateway]:
    """Start an environment and its gateway; other ports than that of rosbridge are free ones."""
    env = user_environ(home, platform.url)
    options = ["--rosbridge-port", str(rosbridge_port), "--foxglove-port", "0"]
    async with platform.robot(f"{tag}_keeper") as robot, robot.environment(tag) as environment:
        await environment.add_node("fibonacci", "Relay", "example_fibonacci.py")
        parameters = await environment.service_client(
            "/example_fibonacci/get_parameters", "rcl_interfaces/GetParameters"
        )
        await call(parameters, {"names": ["use_sim_time"]})  # the node runs
        await parameters.close()
        async with running("gateway", tag, *options, env=env) as command:
            rosbridge = (await command.expect_line("rosbridge: ws://")).split()[1]
            foxglove = (await command.expect_line("foxglove: ws://")).split()[1]
            yield Gateway(rosbridge, foxglove, environment, env)

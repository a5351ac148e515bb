"""`rce gateway` for an environment with the action server of the tutorials."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rce.client import Environment
from tests.support.e2e.consoles import running, user_environ
from tests.support.e2e.real_platform import RealPlatform
from tests.support.e2e.traffic import call

IMAGE, CLOUD = "sensor_msgs/Image", "sensor_msgs/PointCloud2"


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


async def publish_camera_and_cloud(environment: Environment) -> None:
    """Publish a red image of 64 x 48 pixels and a cloud of two points, ten times a second."""
    camera = await environment.publisher("/camera", IMAGE, format="json")
    cloud = await environment.publisher("/cloud", CLOUD)
    image = {"height": 48, "width": 64, "encoding": "rgb8", "step": 192, "data": bytes([255, 0, 0]) * 64 * 48}
    points = np.array([[1, 2, 3], [4, 5, 6]], "<f4")
    fields = [{"name": name, "offset": 4 * n, "datatype": 7, "count": 1} for n, name in enumerate("xyz")]
    sizes = {"height": 1, "width": 2, "point_step": 12, "row_step": 24}
    while True:
        await camera.publish({"header": {"frame_id": "cam"}, **image})
        await cloud.publish({"header": {"frame_id": "map"}, **sizes, "fields": fields, "data": points.tobytes()})
        await asyncio.sleep(0.1)

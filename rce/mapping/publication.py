"""Client of a planning node: gives it a map, over the platform, since its environment may have no network."""

from __future__ import annotations

import asyncio
import secrets
import time
from typing import Any

import numpy as np

from rce.client import Robot
from rce.errors import TimedOut
from rce.mapping.grid import OccupancyGrid
from rce.mapping.robot import NANO, store, types
from rce.protocol.messages import Qos

MAP, COSTMAP = "/map", "/global_costmap/costmap"
LATCHED = Qos(reliability="reliable", durability="transient_local", depth=1)
PATIENCE = 60.0  # seconds; a node compiles its kernels at its first start


async def publish_map(
    url: str, user: str, password: str | None, key: str | None, environment: str, grid: OccupancyGrid
) -> None:
    """Publish a map on `/map` of an environment, and wait until its planning node has published the costmap of it.

    Args:
        url: Entry of the platform.
        user: User name.
        password: Password; either this or `key`.
        key: API key.
        environment: The environment's tag.
        grid: The map.

    Raises:
        TimedOut: No planning node has answered.
        RceError: The platform or the environment cannot be reached.
    """
    stamp = time.time_ns()
    async with Robot(url, user=user, robot=f"map_{secrets.token_hex(4)}", password=password, key=key) as robot:
        place = robot.environment(environment)
        costmaps = await place.subscriber(COSTMAP, "nav_msgs/OccupancyGrid", qos=LATCHED, depth=1, raw=True)
        maps = await place.publisher(MAP, "nav_msgs/OccupancyGrid", qos=LATCHED, raw=True)
        await maps.publish(map_cdr(grid, stamp))
        try:
            async with asyncio.timeout(PATIENCE):
                while load_time(await costmaps.get()) != stamp:
                    pass
        except TimeoutError:
            raise TimedOut(
                f"no planning node took the map within {PATIENCE:g} s: start one in {environment} "
                "(package rce_planning, executable planner)"
            ) from None


def map_cdr(grid: OccupancyGrid, stamp: int) -> bytes:
    """Serialise a map as `nav_msgs/OccupancyGrid` in the frame `map`, stamp in nanoseconds."""
    time_of = types["builtin_interfaces/msg/Time"](sec=stamp // NANO, nanosec=stamp % NANO)
    place = types["geometry_msgs/msg/Point"](x=grid.x, y=grid.y, z=0.0)
    turn = types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
    height, width = grid.cells.shape
    info = types["nav_msgs/msg/MapMetaData"](
        map_load_time=time_of,
        resolution=grid.resolution,
        width=width,
        height=height,
        origin=types["geometry_msgs/msg/Pose"](position=place, orientation=turn),
    )
    header = types["std_msgs/msg/Header"](stamp=time_of, frame_id="map")
    message = types["nav_msgs/msg/OccupancyGrid"](header=header, info=info, data=grid.cells.ravel().astype(np.int8))
    return bytes(store.serialize_cdr(message, "nav_msgs/msg/OccupancyGrid"))


def load_time(cdr: bytes) -> int:
    """Return the field `map_load_time` of a serialised map, nanoseconds."""
    found: Any = store.deserialize_cdr(cdr, "nav_msgs/msg/OccupancyGrid")
    return int(found.info.map_load_time.sec * NANO + found.info.map_load_time.nanosec)

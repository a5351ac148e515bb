"""Services of the catalogue that come with RCE, used by a robot that has no nodes of its own."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import cv2
import numpy as np
import pytest

from rce.client import Service
from rce.mapping.evaluation.simulation import simulate
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.publication import map_cdr
from rce.mapping.robot import nanoseconds, scan_cdr, store
from rce.recognition.fiducials import DICTIONARIES
from tests.support.e2e.real_platform import RealPlatform
from tests.support.plane_scenes import CAMERA, marker, turned, view

SCANS = 60
TIMEOUT = 120.0  # seconds


async def last_pose(localisation: Service, stamp: float) -> Any:
    """Return the pose of the scan of this stamp."""
    async for cdr in localisation.subscriber("amcl_pose"):
        message: Any = store.deserialize_cdr(cdr, "geometry_msgs/msg/PoseWithCovarianceStamped")
        if message.header.stamp.sec + message.header.stamp.nanosec / 1e9 > stamp - 1e-3:
            return message.pose.pose.position
    raise AssertionError("the poses ended")


async def test_robot_is_found_in_a_map_that_it_has(platform: RealPlatform) -> None:
    scans, mapper = simulate().records, GraphMapper()
    for scan in scans:
        mapper.add(scan)
    async with (
        platform.robot("lost") as robot,
        await robot.service("localisation", tag="localisation", raw=True) as localisation,
        asyncio.timeout(TIMEOUT),
    ):
        await localisation.publisher("map").publish(map_cdr(mapper.grid(), 1))
        found = asyncio.create_task(last_pose(localisation, scans[SCANS - 1].stamp))
        while not found.done():  # the node knows the map only after a while
            for scan in scans[:SCANS]:
                await localisation.publisher("scan").publish(scan_cdr(nanoseconds(scan.stamp), scan))
                await asyncio.sleep(0.01)
        truth = mapper.trajectory()[SCANS - 1]
        assert math.dist((found.result().x, found.result().y), truth[1:3]) < 0.15


@pytest.fixture
def image() -> bytes:
    """PNG of an AprilTag of 10 cm, 60 cm before the camera."""
    scene = view(marker(DICTIONARIES["apriltag_36h11"], 7), 0.1, turned(0.3, 0.2), np.array([0.05, 0.0, 0.6]))
    return cv2.imencode(".png", scene)[1].tobytes()


async def test_robot_without_vision_recognises_a_tag(platform: RealPlatform, image: bytes) -> None:
    async with (
        platform.robot("blind") as robot,
        await robot.service("recognition", tag="recognition") as recognition,
        asyncio.timeout(TIMEOUT),
    ):
        seen = recognition.subscriber("detections")
        found = asyncio.create_task(seen.get())
        while not found.done():  # the node may not have its calibration when the first image comes
            await recognition.publisher("camera_info").publish({"k": CAMERA.matrix.ravel().tolist()})
            await recognition.publisher("image").publish({"format": "png", "data": image})
            await asyncio.wait([found], timeout=0.5)
        (detection,) = found.result()["detections"]
        (result,) = detection["results"]
        assert result["hypothesis"]["class_id"] == "apriltag_36h11/7"
        assert result["pose"]["pose"]["position"]["z"] == pytest.approx(0.6, abs=0.03)

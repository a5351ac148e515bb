"""Client of a mapper in an environment, for robots without ROS.

Messages travel as CDR through raw interfaces.
"""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Self

import numpy as np

from rce.client import Environment, Robot
from rce.errors import RceError, StartFailed, TimedOut
from rce.mapping.clouds import Sweep
from rce.mapping.guard import NodeGuard
from rce.mapping.robot import NANO, NODE, START_TIMEOUT, start_node, store, types
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.offload.sending import RATE, Sending
from rce.mapping3d.offload.tracking import Located, RobotTracking
from rce.mapping3d.poses import Pose, from_quaternion
from rce.mapping3d.sensors import CAMERA
from rce.protocol.messages import Qos

PACKAGE, EXECUTABLE = "rce_mapping3d", "mapper"
SETTLE_TIMEOUT = 60.0  # seconds without an answer after which the node is given up
WRITE_TIMEOUT = 600.0  # seconds for the files of a large map
CHECK_INTERVAL = 0.05  # seconds between looks whether something may be sent
DEPTH = 100  # messages in the queues of topics
POSE, PATH, FILE = "geometry_msgs/msg/PoseWithCovarianceStamped", "nav_msgs/msg/Path", "std_msgs/msg/UInt8MultiArray"
IMAGE = "sensor_msgs/msg/CompressedImage"


async def start_mapper(environment: Environment, robots: Sequence[str], sensor: str = CAMERA) -> None:
    """Start the node of the mapper in an environment.

    Args:
        environment: The environment.
        robots: Names of the robots that map together; empty for one robot, whose topics have no prefix.
        sensor: What they measure with, `camera` or `lidar`.

    Raises:
        StartFailed: The node did not start.
    """
    parameters: dict[str, Any] = {"robots": [*robots]} if robots else {}
    if sensor != CAMERA:
        parameters["sensor"] = sensor
    await start_node(environment, EXECUTABLE, parameters, PACKAGE)


class RgbdRobot:
    """Robot with a camera or a lidar that tracks itself, and maps in an environment: an asynchronous context manager.

    While there is no connection it goes on. Key frames wait within `RobotTracking`'s bounds, and go up afterwards.

    Attributes:
        tracking: The robot's own part.
        sending: State of the line.
    """

    def __init__(
        self, robot: Robot, environment: Environment, camera: Camera | None, namespace: str = "", rate: float = RATE
    ) -> None:
        """Use a mapper that was started in an environment.

        Args:
            robot: Connected robot.
            environment: Environment of the node.
            camera: Camera of the frames; None for sweeps of a lidar.
            namespace: "/NAME" of the robot among those of the mapper, or empty.
            rate: Bytes per second of key frames that are not exceeded.
        """
        self.tracking = RobotTracking(camera)
        self.sending = Sending(rate)
        self._environment, self._namespace = environment, namespace
        self._guard = NodeGuard(robot, environment, NODE, self._send_again)
        self._tasks: list[asyncio.Task[None]] = []
        self._answered = asyncio.Event()

    async def __aenter__(self) -> Self:
        """Connect the topics, and wait until the mapper is ready.

        Raises:
            Died: The node or its environment ended.
            TimedOut: It was not ready in time.
        """
        await self._guard.__aenter__()
        environment, own = self._environment, self._namespace
        latched = Qos(reliability="reliable", durability="transient_local", depth=1)
        deep = Qos(reliability="reliable", depth=DEPTH)
        name = "sensor_msgs/CompressedImage"
        self._key_frames = await environment.publisher(f"{own}/key_frames", name, qos=deep, raw=True)
        name = "geometry_msgs/PoseWithCovarianceStamped"
        self._poses = await environment.subscriber(f"{own}/pose", name, qos=deep, depth=DEPTH, raw=True)
        self._corrections = await environment.subscriber(
            f"{own}/corrections", "nav_msgs/Path", qos=deep, depth=DEPTH, raw=True
        )
        self._paths = await environment.service_client(f"{own}/get_path", "nav_msgs/GetPlan")
        self._optimise = await environment.service_client("/optimise", "std_srvs/Trigger")
        ready = await environment.subscriber(f"{own}/map", "nav_msgs/OccupancyGrid", qos=latched, depth=1, raw=True)
        await self._guard.wait(ready.get(), START_TIMEOUT, "the mapping node to be ready")
        await ready.close()
        for work in (self._receive_answers, self._receive_corrections, self._send):
            task = asyncio.create_task(work())
            task.add_done_callback(lambda _: self._answered.set())
            self._tasks.append(task)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Cancel all tasks."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self._guard.__aexit__()

    async def add(self, frame: RgbdFrame | Sweep) -> Located:
        """Track a frame; its key frame, if it makes one, goes up in time. This never waits for the line."""
        return await asyncio.to_thread(self.tracking.add, frame)

    async def settle(self, unanswered: int = 0) -> None:
        """Wait until at most so many key frames are unanswered.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The node has not answered for a minute.
        """
        while len(self.tracking.outbox) > unanswered:
            before = len(self.tracking.outbox)
            await self._guard.wait(self._fewer(before), SETTLE_TIMEOUT, "the mapping node to answer a key frame")

    async def finish(self) -> None:
        """Wait for all answers, have the map optimised, and take over the poses of all key frames.

        Raises:
            Died: The node or its environment ended.
            TimedOut: The node has not answered for a minute.
        """
        await self.settle()
        await self._guard.wait(self._optimise.call({}, WRITE_TIMEOUT), WRITE_TIMEOUT, "the map to be optimised")
        await self.refresh()

    async def refresh(self) -> None:
        """Take over the poses of all key frames: after a cut line corrections may have been lost."""
        answer = await self._guard.wait(self._paths.call({}, SETTLE_TIMEOUT), SETTLE_TIMEOUT, "the path")
        self.tracking.correct(dict(_corrections_of(answer["plan"])))

    async def files(self) -> dict[str, bytes]:
        """Return the files of the map by name.

        Raises:
            Died: The node or its environment ended.
            TimedOut: They did not arrive in time.
        """
        environment, own = self._environment, self._namespace
        deep = Qos(reliability="reliable", depth=DEPTH)
        pieces = await environment.subscriber(
            f"{own}/files", "std_msgs/UInt8MultiArray", qos=deep, depth=DEPTH, raw=True
        )
        export = await environment.service_client(f"{own}/export", "std_srvs/Trigger")
        try:
            answer = await self._guard.wait(export.call({}, WRITE_TIMEOUT), WRITE_TIMEOUT, "the files of the map")
            if not answer["success"]:
                raise StartFailed(f"the mapping node wrote no files: {answer['message']}")
            found = {name: bytearray() for name in json.loads(answer["message"])}
            sizes: dict[str, int] = {}
            while any(len(content) < sizes.get(name, 1) for name, content in found.items()):
                cdr = await self._guard.wait(pieces.get(), SETTLE_TIMEOUT, "the files of the map")
                message: Any = store.deserialize_cdr(cdr, FILE)
                entry = message.layout.dim[0]
                sizes[entry.label] = entry.size
                found[entry.label][message.layout.data_offset :] = np.asarray(message.data, np.uint8).tobytes()
            return {name: bytes(content) for name, content in found.items()}
        finally:
            await pieces.close()
            await export.close()

    # --- tasks

    async def _send(self) -> None:
        while True:
            for stamp, format, data in self.sending.due(self.tracking.outbox, time.monotonic()):
                with suppress(RceError):  # it is sent again
                    await self._key_frames.publish(image_cdr(stamp, format, data))
            await asyncio.sleep(CHECK_INTERVAL)

    async def _receive_answers(self) -> None:
        async for cdr in self._poses:
            message: Any = store.deserialize_cdr(cdr, POSE)
            self.sending.answered(self.tracking.outbox, microseconds(message.header.stamp), time.monotonic())
            self._answered.set()

    async def _receive_corrections(self) -> None:
        async for cdr in self._corrections:
            message: Any = store.deserialize_cdr(cdr, PATH)
            self.tracking.correct(dict(_corrections_of(message)))

    async def _fewer(self, count: int) -> None:
        while len(self.tracking.outbox) >= count:
            for task in self._tasks:
                if task.done():
                    task.result()  # raises what ended it
            self._answered.clear()
            await self._answered.wait()

    async def _send_again(self) -> None:
        self.sending.restart()
        with suppress(TimedOut):
            await self.refresh()


def image_cdr(stamp: float, format: str, data: bytes) -> bytes:
    """Serialise bytes as `sensor_msgs/CompressedImage`."""
    nanoseconds = round(stamp * 1e6) * 1000
    time = types["builtin_interfaces/msg/Time"](sec=nanoseconds // NANO, nanosec=nanoseconds % NANO)
    header = types["std_msgs/msg/Header"](stamp=time, frame_id="camera")
    message = types[IMAGE](header=header, format=format, data=np.frombuffer(data, np.uint8))
    return bytes(store.serialize_cdr(message, IMAGE))


def _corrections_of(path: Any) -> list[tuple[int, tuple[Pose, str]]]:
    """Return stamp in microseconds, pose and map of the poses of a path, a message or a dict."""
    found = []
    for each in _get(path, "poses"):
        header, pose = _get(each, "header"), _get(each, "pose")
        place, turn = _get(pose, "position"), _get(pose, "orientation")
        translation = [_get(place, axis) for axis in "xyz"]
        matrix = from_quaternion(translation, [_get(turn, axis) for axis in "xyzw"])
        found.append((microseconds(_get(header, "stamp")), (matrix, str(_get(header, "frame_id")))))
    return found


def microseconds(stamp: Any) -> int:
    """Return a stamp, a message or a dict, in microseconds."""
    return int(_get(stamp, "sec") * NANO + _get(stamp, "nanosec") + 500) // 1000


def _get(value: Any, name: str) -> Any:
    """Return a field of a message, or of a dict with the same fields."""
    return value[name] if isinstance(value, dict) else getattr(value, name)

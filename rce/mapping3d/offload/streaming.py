"""Client of a mapper in an environment, for robots that do not track themselves: all frames go up, poses come back."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self

from rce.client import Environment, Robot
from rce.errors import RceError
from rce.mapping.guard import NodeGuard
from rce.mapping.robot import NODE, START_TIMEOUT, store
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.offload.client import DEPTH, POSE, image_cdr, microseconds
from rce.mapping3d.offload.streams import FORMAT, Format, FrameEncoder
from rce.mapping3d.poses import Pose, from_quaternion
from rce.protocol.messages import Qos
from rce.video.rate import RateControl

WINDOW = 6  # frames that may be unanswered; a further one is dropped, so that poses do not become old
PATIENCE = 5.0  # seconds without an answer after which unanswered frames are given up
LOST = 1e5  # variance of a frame that has no pose, square metres


@dataclass(frozen=True, slots=True)
class Answer:
    """Pose that came back.

    Attributes:
        stamp: Stamp of the frame, seconds.
        pose: (4, 4) camera to the frame of the map.
        map: Frame of the map.
        lost: True if the cloud could not track the frame: the pose means nothing.
    """

    stamp: float
    pose: Pose
    map: str
    lost: bool


class StreamingRobot:
    """Robot with a camera whose frames are tracked in the cloud. Use it as an asynchronous context manager.

    Without a line there are no poses: a robot that must go on alone uses `RgbdRobot`.

    Attributes:
        last: The newest answer, None before the first.
        sent: Bytes of frames.
        dropped: Number of frames that were not sent, because the line or the cloud is too slow.
    """

    def __init__(
        self, robot: Robot, environment: Environment, camera: Camera, namespace: str = "", format: Format = "jpeg"
    ) -> None:
        """Use a mapper that was started in an environment.

        Args:
            robot: Connected robot.
            environment: Environment of the node.
            camera: Camera of the frames.
            namespace: "/NAME" of the robot among those of the mapper, or empty.
            format: Of the colours; all but `jpeg` need the extra `video` at both ends.

        Raises:
            ModuleNotFoundError: The format needs the extra `video`.
        """
        self.last: Answer | None = None
        self.sent = self.dropped = 0
        self._encoder, self._control = FrameEncoder(camera, format), RateControl()
        self._environment, self._namespace = environment, namespace
        self._guard = NodeGuard(robot, environment, NODE, self._begin_again)
        self._unanswered: set[int] = set()  # stamps, microseconds
        self._heard = 0.0
        self._receiver: asyncio.Task[None] | None = None

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
        self._frames = await environment.publisher(f"{own}/frames", "sensor_msgs/CompressedImage", qos=deep, raw=True)
        name = "geometry_msgs/PoseWithCovarianceStamped"
        self._poses = await environment.subscriber(f"{own}/pose", name, qos=deep, depth=DEPTH, raw=True)
        ready = await environment.subscriber(f"{own}/map", "nav_msgs/OccupancyGrid", qos=latched, depth=1, raw=True)
        await self._guard.wait(ready.get(), START_TIMEOUT, "the mapping node to be ready")
        await ready.close()
        self._receiver = asyncio.create_task(self._receive())
        return self

    async def __aexit__(self, *_: object) -> None:
        """Cancel the receiver, and stop watching the node."""
        if self._receiver is not None:
            self._receiver.cancel()
            await asyncio.gather(self._receiver, return_exceptions=True)
        await self._guard.__aexit__()

    async def add(self, frame: RgbdFrame) -> bool:
        """Send a frame; return False if it was dropped. This does not wait for the answer."""
        now = time.monotonic()
        if self._unanswered and now - self._heard > PATIENCE:
            await self._begin_again()
        full = len(self._unanswered) >= WINDOW
        if self._control.report(now, full):
            self._encoder.set_rate(self._control.rate)
        if full:
            self.dropped += 1
            return False
        data = await asyncio.to_thread(self._encoder.encode, frame)
        if not self._unanswered:
            self._heard = now
        self._unanswered.add(round(frame.stamp * 1e6))
        self.sent += len(data)
        with suppress(RceError):  # it counts as unanswered
            await self._frames.publish(image_cdr(frame.stamp, FORMAT, data))
        return True

    async def _receive(self) -> None:
        async for cdr in self._poses:
            message: Any = store.deserialize_cdr(cdr, POSE)
            stamp = microseconds(message.header.stamp)
            self._unanswered.discard(stamp)
            self._heard = time.monotonic()
            lost = message.pose.covariance[0] > LOST
            if lost:
                self._encoder.request_key()
            place, turn = message.pose.pose.position, message.pose.pose.orientation
            pose = from_quaternion((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
            self.last = Answer(stamp * 1e-6, pose, message.header.frame_id, lost)

    async def _begin_again(self) -> None:
        """Give up what was not answered: the line was cut."""
        self._unanswered.clear()
        self._encoder.request_key()

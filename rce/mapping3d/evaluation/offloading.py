"""Costs of the ways to divide the work between a robot and the cloud: the figure on offloading of the Rapyuta paper.

Mohanarajah, Hunziker, Waibel and D'Andrea, Rapyuta: A Cloud Robotics Platform, 2015, section VI.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from rce.mapping3d.evaluation.errors import trajectory_error
from rce.mapping3d.files.recordings import RgbdRecording
from rce.mapping3d.files.trajectories import Stamped
from rce.mapping3d.frames import RgbdFrame, reduced, reduced_camera
from rce.mapping3d.graph.trajectory import Trajectory
from rce.mapping3d.odometry.tracker import Tracker
from rce.mapping3d.offload.messages import decode, encode
from rce.mapping3d.offload.shared_map import SharedMap
from rce.mapping3d.offload.streams import Format, FrameDecoder, FrameEncoder
from rce.mapping3d.offload.tracking import RobotTracking
from rce.mapping3d.poses import Pose

Way = Literal["robot", "key frames", "jpeg", "h264", "av1", "vp9"]
WAYS: tuple[Way, ...] = ("robot", "key frames", "jpeg", "h264", "av1", "vp9")
ROBOT = "robot"


@dataclass(frozen=True, slots=True)
class Offloading:
    """Cost of one way.

    Attributes:
        recording: Name of the recording.
        way: `robot`: all on the robot; `key frames`: tracking on the robot; else the format in which all frames go up.
        line_rate: Bytes a second from the robot, in the time of the recording.
        robot_load: CPU time of the robot by the time of the recording; 1 is a core.
        cloud_load: The same of the cloud.
        absolute: Absolute trajectory error, metres, root mean square; NaN without ground truth.
    """

    recording: str
    way: Way
    line_rate: float
    robot_load: float
    cloud_load: float
    absolute: float


@dataclass(slots=True)
class _Costs:
    """CPU seconds of robot and cloud, and bytes between them."""

    robot: float = 0.0
    cloud: float = 0.0
    sent: int = 0
    path: Trajectory = field(default_factory=Trajectory)

    @contextmanager
    def on_robot(self) -> Iterator[None]:
        """Count what is done inside as work of the robot."""
        began = time.process_time()
        yield
        self.robot += time.process_time() - began

    @contextmanager
    def in_cloud(self) -> Iterator[None]:
        """Count what is done inside as work of the cloud."""
        began = time.process_time()
        yield
        self.cloud += time.process_time() - began


def measure(recording: RgbdRecording, truth: list[Stamped], way: Way) -> Offloading:
    """Map a recording in one way, and return what it costs. Reading the recording costs nothing.

    Raises:
        InvalidRequest: The recording is damaged, or its stamps are not those of the ground truth.
        ModuleNotFoundError: The format needs the extra `video`.
    """
    shared, costs = SharedMap([ROBOT]), _Costs()
    frames = list(_frames(recording))
    if way == "key frames":
        poses = _key_frames(frames, recording, shared, costs)
    else:
        poses = _all_frames(frames, recording, shared, costs, way)
    shared.close()
    duration = max(frames[-1].stamp - frames[0].stamp, 1e-9) if frames else 1.0
    error = trajectory_error(poses, truth).absolute if truth else math.nan
    return Offloading(recording.name, way, costs.sent / duration, costs.robot / duration, costs.cloud / duration, error)


def _frames(recording: RgbdRecording) -> Iterator[RgbdFrame]:
    """Yield the frames of a recording at the size of the front end, as a robot's camera would give them."""
    last = -math.inf
    for frame in recording:
        if frame.stamp > last:
            last = frame.stamp
            yield reduced(frame)


def _key_frames(frames: list[RgbdFrame], recording: RgbdRecording, shared: SharedMap, costs: _Costs) -> list[Stamped]:
    """Track on the robot, and map in the cloud; the robot's trajectory is what it knows at the end."""
    robot = RobotTracking(reduced_camera(recording.camera))
    for frame in frames:
        with costs.on_robot():
            costs.path.add(robot.add(frame).tracked)
            message = robot.outbox.after(-1)
            data = encode(message) if message is not None else b""
        if message is None:
            continue
        costs.sent += len(data)
        with costs.in_cloud():
            shared.add(ROBOT, decode(data))
            corrections = shared.corrections(ROBOT)
        with costs.on_robot():
            robot.outbox.acknowledge(message.index)
            robot.correct({round(each.stamp * 1e6): (each.pose, each.map) for each in corrections})
    with costs.in_cloud():
        shared.optimise()
    with costs.on_robot():
        robot.correct({round(each.stamp * 1e6): (each.pose, each.map) for each in shared.poses(ROBOT)})
    return costs.path.poses(robot.key_pose)


def _all_frames(
    frames: list[RgbdFrame], recording: RgbdRecording, shared: SharedMap, costs: _Costs, way: Way
) -> list[Stamped]:
    """Track where the map is: in the cloud, to which all frames are sent, or all on the robot."""
    camera = reduced_camera(recording.camera)
    tracker, local = Tracker(camera), way == "robot"
    place = costs.on_robot if local else costs.in_cloud
    encoder, decoder = FrameEncoder(camera, _format(way)), FrameDecoder()
    for frame in frames:
        arrived: RgbdFrame = frame
        if not local:
            with costs.on_robot():
                data = encoder.encode(frame)
            costs.sent += len(data)
            with costs.in_cloud():
                found = decoder.decode(data)
            if found is None:
                continue
            arrived = found[0]
        with place():
            tracked = tracker.add(arrived)
            shared.add_tracked(ROBOT, "run", tracked)
            costs.path.add(tracked)
    with place():
        shared.optimise()
    poses: dict[int, Pose] = {each.index: each.pose for each in shared.poses(ROBOT)}
    return costs.path.poses(lambda index: poses[index])


def _format(way: Way) -> Format:
    return "jpeg" if way in ("robot", "key frames") else way  # type: ignore[return-value]

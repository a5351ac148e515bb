"""A mapper in an environment, as a robot's client sees it, without a platform: it answers with a real map."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from rce.client import Event, Stream
from rce.errors import Unavailable
from rce.mapping.robot import store, types
from rce.mapping3d.offload import streams
from rce.mapping3d.offload.messages import decode
from rce.mapping3d.offload.shared_map import Corrected, SharedMap
from rce.mapping3d.poses import to_quaternion


class Subscriber(Stream[bytes]):
    async def close(self) -> None:
        self.end(None)


class Service:
    def __init__(self, answer: Any) -> None:
        self._answer = answer

    async def call(self, request: Any, timeout: float) -> Any:  # noqa: ASYNC109  # as ServiceClient
        return self._answer()

    async def close(self) -> None:
        pass


class CloudMapper:
    """Robot and environment in one, with a mapper in it.

    Attributes:
        shared: The map.
        cut: While it is True nothing arrives.
        mute: While it is True nothing is answered.
        events_stream: What the robot's `events` give.
        received: Number of key frames that arrived.
    """

    tag = "brain"

    def __init__(self, namespace: str = "") -> None:
        self._namespace = namespace
        self.shared = SharedMap(["robot"])
        self.cut = self.mute = False
        self._decoder = streams.FrameDecoder()
        self.received = 0
        self.events_stream: Stream[Event] = Stream(100)
        self.topics: dict[str, Subscriber] = {}

    def events(self) -> Stream[Event]:
        return self.events_stream

    async def publisher(self, topic: str, type_name: str, **options: Any) -> CloudMapper:
        return self

    async def subscriber(self, topic: str, type_name: str, **options: Any) -> Subscriber:
        own = topic.removeprefix(self._namespace)
        self.topics[own] = stream = Subscriber(1000)
        if own == "/map":
            stream.put(b"ready")
        return stream

    async def service_client(self, name: str, type_name: str, **options: Any) -> Service:
        answers = {"/get_path": self._path, "/optimise": self._optimise, "/export": self._export}
        return Service(answers[name.removeprefix(self._namespace)])

    async def publish(self, cdr: bytes) -> None:
        if self.cut:
            raise Unavailable("the line is cut")
        message: Any = store.deserialize_cdr(cdr, "sensor_msgs/msg/CompressedImage")
        self.received += 1
        if message.format == streams.FORMAT:
            found = self._decoder.decode(message.data.tobytes())
            self._answer(message.header, np.eye(4), 0.01 if found else 1e6)
        elif self.shared.add("robot", decode(message.data.tobytes())):
            path = path_message(self.shared.corrections("robot"))
            self.topics["/corrections"].put(bytes(store.serialize_cdr(path, "nav_msgs/msg/Path")))
            self._answer(message.header, np.eye(4), 0.01)

    def _answer(self, header: Any, pose: Any, variance: float) -> None:
        if not self.mute:
            covariance = np.full(36, variance)
            answer = types["geometry_msgs/msg/PoseWithCovarianceStamped"](
                header=header,
                pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=pose_message(pose), covariance=covariance),
            )
            name = "geometry_msgs/msg/PoseWithCovarianceStamped"
            self.topics["/pose"].put(bytes(store.serialize_cdr(answer, name)))

    def _path(self) -> dict[str, Any]:
        path = path_message(self.shared.poses("robot"))
        return {"plan": path}

    def _optimise(self) -> dict[str, Any]:
        self.shared.optimise()
        return {"success": True}

    def _export(self) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as directory:
            paths = self.shared.write("robot", Path(directory))
            for path in paths:
                content = path.read_bytes()
                for begin in range(0, len(content), 100_000):
                    self.topics["/files"].put(piece(path.name, content, begin))
        return {"success": True, "message": json.dumps([path.name for path in paths])}


def piece(name: str, content: bytes, begin: int) -> bytes:
    entry = types["std_msgs/msg/MultiArrayDimension"](label=name, size=len(content), stride=len(content))
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[entry], data_offset=begin)
    data = np.frombuffer(content[begin : begin + 100_000], np.uint8)
    message = types["std_msgs/msg/UInt8MultiArray"](layout=layout, data=data)
    return bytes(store.serialize_cdr(message, "std_msgs/msg/UInt8MultiArray"))


def pose_message(pose: Any) -> Any:
    place = types["geometry_msgs/msg/Point"](*pose[:3, 3].tolist())
    turn = types["geometry_msgs/msg/Quaternion"](*to_quaternion(pose).tolist())
    return types["geometry_msgs/msg/Pose"](position=place, orientation=turn)


def path_message(poses: list[Corrected]) -> Any:
    found = []
    for each in poses:
        stamp = types["builtin_interfaces/msg/Time"](int(each.stamp), round(each.stamp % 1 * 1e6) * 1000)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=each.map)
        found.append(types["geometry_msgs/msg/PoseStamped"](header=header, pose=pose_message(each.pose)))
    empty = types["std_msgs/msg/Header"](stamp=types["builtin_interfaces/msg/Time"](0, 0), frame_id="map")
    return types["nav_msgs/msg/Path"](header=empty, poses=found)

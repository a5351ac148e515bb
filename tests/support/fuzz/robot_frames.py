"""Frames that a robot may send, one template for each kind of message, and their mutations."""

from __future__ import annotations

import struct
import zlib
from typing import Any

from tests.support.fuzz.mutation import Mutator, encode

STRING, IMAGE, TWIST = "std_msgs/String", "sensor_msgs/Image", "geometry_msgs/Twist"
SERVICE = "std_srvs/SetBool"
BLOB = "0123456789abcdef" * 2
INTERFACES = (
    ("text", "SubscriberConverter", STRING), ("image", "SubscriberConverter", IMAGE),
    ("raw", "SubscriberForwarder", STRING), ("twist", "SubscriberConverter", TWIST),
    ("back", "PublisherConverter", STRING), ("picture", "PublisherConverter", IMAGE),
    ("rawback", "PublisherForwarder", STRING), ("call", "ServiceProviderConverter", SERVICE),
    ("serve", "ServiceClientConverter", SERVICE), ("scan", "SubscriberConverter", "sensor_msgs/LaserScan"),
)  # fmt: skip
CONNECTIONS = (("text", "back"), ("image", "picture"), ("raw", "rawback"), ("call", "serve"))
PICTURE = (
    b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\0\0\0\0:~\x9bU\0\0\0\nIDATx\x9cc`\0\0\0\2\0\1H\xaf\xa4q"
    b"\0\0\0\0IEND\xaeB`\x82"
)


def declarations(robot: str) -> list[dict[str, Any]]:
    """Return frames that add INTERFACES to a robot and connect some, so that its data messages reach the converters."""
    items = [
        {"endpointTag": robot, "interfaceTag": tag, "interfaceType": kind, "className": type}
        for tag, kind, type in INTERFACES
    ]
    connect = [{"tagA": f"{robot}/{one}", "tagB": f"{robot}/{other}"} for one, other in CONNECTIONS]
    return [{"type": "CN", "data": {"addInterfaces": items}}, {"type": "CX", "data": {"connect": connect}}]


def _data(tag: str, type: str, msg: Any, msg_id: str = "nil", **more: Any) -> dict[str, Any]:
    return {"type": "DM", "data": {"iTag": tag, "type": type, "msgID": msg_id, "msg": msg, **more}}


def templates(robot: str) -> list[dict[str, Any]]:
    """Return one valid frame of each kind, of a robot with INTERFACES."""
    vector = {"x": 1.0, "y": -2.5, "z": 0}
    header = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "f"}
    scan = {"header": header, "angle_min": -1.5, "ranges": [1.0, 2.5, None]}
    parameter = {"containerTag": "env", "name": "p", "value": [1, {"a": 2.5}], "nodeTag": ""}
    picture = {"height": 1, "width": 2, "encoding": "mono8", "step": 2, "data": [1, 2]}
    options = {"image": "", "size": 1, "cpu": 0.5, "memory": 1000, "env": {"A": "b"}, "group": "g", "restart": "no"}
    node = {"containerTag": "env", "nodeTag": "n", "pkg": "p", "exe": "e", "args": "a", "namespace": "/n"}
    end = {"endpointTag": robot, "interfaceTag": "extra", "interfaceType": "PublisherConverter", "className": TWIST}
    qos = {"reliability": "reliable", "durability": "volatile", "history": "keep_all", "depth": 5}
    goal = {"iTag": "act", "type": "example_interfaces/Fibonacci", "msgID": BLOB, "phase": "goal", "msg": {"order": 3}}
    return [
        _data("text", STRING, {"data": "hello"}),
        _data("twist", TWIST, {"linear": vector, "angular": vector}),
        _data("scan", "sensor_msgs/LaserScan", scan),
        _data("image", IMAGE, picture),
        _data("call", SERVICE, {"data": True}, "id 1"),
        _data("serve", SERVICE, {"success": True, "message": "m"}, "id 1"),
        _data("serve", SERVICE, {}, "id 1", error="failed"),
        {"type": "DM", "data": {"iTag": "image", "type": IMAGE, "msgID": "nil", "msg*": BLOB}},
        {"type": "DM", "data": {"iTag": "raw", "type": STRING, "msgID": "nil", "msg*": BLOB}},
        _data("scan", "sensor_msgs/LaserScan", {"ranges*": BLOB, "intensities*": [BLOB, BLOB]}),
        {"type": "DM", "data": goal},
        {"type": "DM", "data": {**goal, "phase": "result", "status": "succeeded", "ifLost": "cancel"}},
        {"type": "CC", "data": {"containerTag": "env", "containerData": options}},
        {"type": "DC", "data": {"containerTag": "env"}},
        {"type": "CN", "data": {"addNodes": [node], "removeNodes": [{"containerTag": "env", "nodeTag": "n"}]}},
        {"type": "CN", "data": {"addInterfaces": [{**end, "qos": qos, "format": "jpeg", "addr": "/t"}, end]}},
        {"type": "CN", "data": {"removeInterfaces": [{"endpointTag": robot, "interfaceTag": "extra"}]}},
        {"type": "CN", "data": {"setParam": [parameter]}},
        {"type": "CN", "data": {"deleteParam": [{"containerTag": "env", "name": "p"}]}},
        {"type": "CX", "data": {"connect": [{"tagA": f"{robot}/text", "tagB": f"{robot}/back"}]}},
        {"type": "CX", "data": {"disconnect": [{"tagA": f"{robot}/scan", "tagB": f"{robot}/back"}], "connect": []}},
        {"type": "ST", "data": {"topic": "ack"}, "id": 5},
        {"type": "ER", "data": {"code": "x", "message": "y"}},
    ]


class FrameGrammar:
    """Grammar of what a robot sends after the handshake: each case is one message, or a piece of a stream."""

    def __init__(self, mutator: Mutator, robot: str, parts: bool, deflate: bool) -> None:
        self._mutator = mutator
        self._templates = templates(robot)
        self._parts = parts
        self._deflate = deflate
        self._messages = (*[self._json] * 10, *[self._blob] * 3, self._fragments, self._control, self._noise)
        self._streams = (self._broken, self._broken, self._compressed, self._close)

    def message(self) -> bytes:
        """Return the bytes of one case that leaves the stream in order: it is answered or ignored."""
        return self._mutator.choose(self._messages)()

    def stream(self) -> bytes:
        """Return the bytes of one case that may break the stream, or end it."""
        return self._mutator.choose(self._streams)()

    def _json(self) -> bytes:
        template = self._mutator.choose(self._templates)
        with_id = {**template, "id": self._mutator.choose((1, "x", -1))} if self._mutator.chance(0.3) else template
        return frame(self._mutator.json(with_id))

    def _blob(self) -> bytes:
        """Return a blob, or a part of one, in most cases for a message that refers to it."""
        mutator = self._mutator
        content = mutator.choose((PICTURE, b"\0\1\0\0\6\0\0\0hello\0", b"x" * 1000, b""))
        content = mutator.damage(content) if mutator.chance(0.7) else content
        total = mutator.choose((len(content), len(content), 2**31, 0, len(content) + 1))
        position = struct.pack("!II", mutator.choose((0, 0, 0, 5, 2**32 - 1)), total) if self._parts else b""
        blob = BLOB.encode() + position + content
        told = frame(encode(mutator.choose(self._templates[7:10]))) if mutator.chance(0.7) else b""
        return told + frame(mutator.damage(blob, 1) if mutator.chance(0.3) else blob, 2)

    def _fragments(self) -> bytes:
        pieces = self._mutator.pieces(encode(self._mutator.choose(self._templates)))
        last = len(pieces) - 1
        frames = [frame(each, 0 if index else 1, index == last) for index, each in enumerate(pieces)]
        if self._mutator.chance(0.3):
            frames.insert(self._mutator.choose(range(len(frames))), frame(b"ping", 9))
        return b"".join(frames)

    def _control(self) -> bytes:
        return frame(self._mutator.noise(125), self._mutator.choose((9, 10)))

    def _close(self) -> bytes:
        code = struct.pack("!H", self._mutator.choose((1000, 1001, 1005, 1006, 4000, 0, 65535)))
        return frame(code[: self._mutator.choose((2, 2, 1, 0))] + self._mutator.noise(120), 8)

    def _noise(self) -> bytes:
        return frame(self._mutator.noise(200), self._mutator.choose((1, 2)))

    def _broken(self) -> bytes:
        """Return frames that break the rules of RFC 6455."""
        head = self._mutator.damage(frame(encode(self._mutator.choose(self._templates))), 2)
        return head if self._mutator.chance(0.7) else self._mutator.noise(64)

    def _compressed(self) -> bytes:
        packer = zlib.compressobj(9, zlib.DEFLATED, -15)
        text = encode(self._mutator.choose(self._templates)) + b" " * self._mutator.choose((0, 0, 10_000, 1_000_000))
        packed = (packer.compress(text) + packer.flush(zlib.Z_SYNC_FLUSH))[:-4]
        if self._mutator.chance(0.5):
            packed = self._mutator.damage(packed)
        return frame(packed, 1, reserved=4) if self._deflate or self._mutator.chance(0.2) else frame(text)


def frame(payload: bytes, opcode: int = 1, final: bool = True, reserved: int = 0) -> bytes:
    """Return one masked frame (RFC 6455, section 5.2); its mask of zeros leaves the payload as it is."""
    size = len(payload)
    first = bytes([final << 7 | reserved << 4 | opcode])
    if size < 126:
        return first + bytes([128 | size]) + b"\0\0\0\0" + payload
    if size < 1 << 16:
        return first + b"\xfe" + size.to_bytes(2) + b"\0\0\0\0" + payload
    return first + b"\xff" + size.to_bytes(8) + b"\0\0\0\0" + payload

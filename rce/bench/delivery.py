"""Bytes of messages on the line to a robot, by the options of its interface.

A robot sends recorded images and made messages to another interface of its own, which has the options, and counts the
bytes of the frames and blobs that come.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET

from rce.bench.report import aligned
from rce.bench.video import read
from rce.client import Robot
from rce.client.connection import Message
from rce.protocol.messages import Decimation, Delivery

TIMEOUT = 60.0  # seconds
FREQUENCY = 30.0  # messages per second, for bytes per second
POINTS = 20_000
HEADER = {"stamp": {"sec": 1_700_000_000, "nanosec": 123_456_789}, "frame_id": "base"}
IMAGE, CLOUD, SCAN, ODOMETRY = (
    *("sensor_msgs/Image", "sensor_msgs/PointCloud2"),
    *("sensor_msgs/LaserScan", "nav_msgs/Odometry"),
)


class Case(NamedTuple):
    """One way to receive messages.

    Attributes:
        messages: What is sent.
        name: The options, for the table.
        options: Options of `Robot.subscriber`.
    """

    messages: str
    name: str
    options: dict[str, Any]


class Figures(msgspec.Struct, frozen=True):
    """Measurements of one case.

    Attributes:
        messages: What is sent.
        name: The options.
        bytes: Bytes of a message on the line, on average.
        rate: Messages per second, at 30 Hz of the sender.
        saved: Share of the bytes of the first case of these messages that is saved.
    """

    messages: str
    name: str
    bytes: float
    rate: float
    saved: float


HALF, QUARTER = Delivery(decimate=Decimation(size=(320, 240))), Delivery(decimate=Decimation(step=4))
POSE = Delivery(fields=("header.stamp", "pose.pose"))
JSON: dict[str, Any] = {"format": "json"}
CASES = (
    Case("odometry", "JSON", {}),
    Case("odometry", "JSON, rate 10", {"delivery": Delivery(rate=10)}),
    Case("odometry", "JSON, 2 fields", {"delivery": POSE}),
    Case("odometry", "CBOR", {"format": "cbor"}),
    Case("odometry", "CBOR, 2 fields", {"format": "cbor", "delivery": POSE}),
    Case("scan", "JSON", {}),
    Case("scan", "JSON, every 4th beam", {"delivery": QUARTER}),
    Case("scan", "CBOR", {"format": "cbor"}),
    Case("scan", "CDR, every 4th beam", {"raw": True, "delivery": QUARTER}),
    Case("colour", "CDR", {"raw": True}),
    Case("colour", "PNG", {"format": "png"}),
    Case("colour", "JPEG", {"format": "jpeg"}),
    Case("colour", "JPEG, 320 x 240", {"format": "jpeg", "delivery": HALF}),
    Case("colour", "codec h264", {"codec": "h264"}),
    Case("colour", "codec av1", {"codec": "av1"}),
    Case("colour", "codec vp9", {"codec": "vp9"}),
    Case("colour", "codec h264, 320 x 240", {"codec": "h264", "delivery": HALF}),
    Case("depth", "CDR", {"raw": True}),
    Case("depth", "PNG", {"format": "png"}),
    Case("depth", "codec png", {"codec": "png"}),
    Case("depth", "codec ffv1", {"codec": "ffv1"}),
    Case("depth", "codec palette", {"codec": "palette"}),
    Case("cloud", "CDR", {"raw": True}),
    Case("cloud", "JSON", {}),
    Case("cloud", "CDR, every 4th point", {"raw": True, "delivery": QUARTER}),
    Case("cloud", "codec quantised", {"codec": "quantised"}),
    Case("cloud", "codec draco", {"codec": "draco"}),
)


class Source(NamedTuple):
    """Messages of one type."""

    type_name: str
    values: Sequence[dict[str, Any]]


def sources(recording: Path, count: int) -> dict[str, Source]:
    """Return the messages by their names in `CASES`.

    Args:
        recording: Directory with pairs of colour and depth, as for `rce bench video`.
        count: Number of messages of each.

    Raises:
        InvalidRequest: There are no images.
    """
    colors, depths = read(recording, count)
    return {
        "odometry": Source(ODOMETRY, [_odometry(number) for number in range(count)]),
        "scan": Source(SCAN, [_scan(number) for number in range(count)]),
        "colour": Source(IMAGE, [_image(each, "rgb8") for each in colors]),
        "depth": Source(IMAGE, [_image(each, "16UC1") for each in depths]),
        "cloud": Source(CLOUD, [_cloud(each) for each in depths]),
    }


def _odometry(number: int) -> dict[str, Any]:
    position = {"x": number / 7, "y": number / 11, "z": 0.0}
    return {"header": HEADER, "child_frame_id": "base_link", "pose": {"pose": {"position": position}}}


def _scan(number: int) -> dict[str, Any]:
    ranges = 4 + np.sin(np.arange(1080) / 50 + number / 10)
    return {"header": HEADER, "angle_increment": 0.004, "range_max": 30.0, "ranges": ranges.round(3)}


def _image(pixels: Any, encoding: str) -> dict[str, Any]:
    height, width = pixels.shape[:2]
    sizes = {"height": height, "width": width, "step": pixels.nbytes // height}
    return {"header": HEADER, "encoding": encoding, "data": pixels.tobytes(), **sizes}


def _cloud(depth: Any) -> dict[str, Any]:
    """Return the points of a depth image (height, width) in millimetres, by the camera of a Kinect."""
    rows, columns = np.nonzero(depth)
    kept = np.linspace(0, len(rows) - 1, min(POINTS, len(rows))).astype(int)
    z = depth[rows[kept], columns[kept]].astype(np.float32) / 1000
    x, y = (columns[kept] - depth.shape[1] / 2) / 585 * z, (rows[kept] - depth.shape[0] / 2) / 585 * z
    points = np.stack([x, y, z], axis=1).astype("<f4")
    fields = [{"name": name, "offset": 4 * at, "datatype": 7, "count": 1} for at, name in enumerate("xyz")]
    sizes = {"height": 1, "width": len(points), "point_step": 12, "row_step": points.nbytes}
    return {"header": HEADER, "fields": fields, "data": points.tobytes(), "is_dense": True, **sizes}


async def measure(robot: Robot, found: dict[str, Source], cases: Sequence[Case] = CASES) -> list[Figures]:
    """Return the figures of each case."""
    figures: list[Figures] = []
    for number, case in enumerate(cases):
        source = found[case.messages]
        there = await robot.publisher(f"out{number}", source.type_name)
        back = await robot.subscriber(f"in{number}", source.type_name, to=f"{robot.name}/out{number}", **case.options)
        back._receive = lambda message, back=back: back.stream.put(size_of(message))  # type: ignore[method-assign,misc]
        sizes = []
        for value in source.values:
            await there.publish(value)
            sizes.append(await back.get(TIMEOUT))
        await back.close()
        await there.close()
        rate = min(FREQUENCY, case.options.get("delivery", Delivery()).rate or FREQUENCY)
        average = sum(sizes) / len(sizes)
        first = next((each for each in figures if each.messages == case.messages), None)
        saved = 1 - average * rate / (first.bytes * first.rate) if first else 0.0
        figures.append(Figures(case.messages, case.name, average, rate, saved))
    return figures


def size_of(message: Message) -> int:
    """Return the bytes of the value and the blobs of a message."""
    raw = message.data.blob if message.data.msg is UNSET else message.data.msg
    value = b"" if raw is UNSET else bytes(raw)
    return len(value) + sum(map(len, message.blobs.values()))


def as_text(figures: Sequence[Figures]) -> str:
    """Return the figures as a table."""
    return "\n".join(aligned([["messages", "options", "bytes", "kB/s", "saved"], *_rows(figures)]))


def _rows(figures: Sequence[Figures]) -> Iterator[list[str]]:
    for each in figures:
        rate = each.bytes * each.rate / 1e3
        yield [each.messages, each.name, f"{each.bytes:,.0f}", f"{rate:,.1f}", f"{each.saved:.1%}"]

"""ONNX files of a tiny detector, written without a library: its boxes are constant, their scores the brightest pixel.

The format is that of onnx.proto: fields by number, as protobuf encodes them.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

FLOAT, STRING, INT = 1, 3, 2  # numbers of ONNX's types of tensors and of attributes
OPSET, IR = 13, 8


def varint(number: int) -> bytes:
    out = bytearray()
    while number > 127:
        out.append(number & 127 | 128)
        number >>= 7
    return bytes([*out, number])


def field(number: int, value: int | str | bytes) -> bytes:
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def node(kind: str, inputs: Sequence[str], output: str, attributes: bytes = b"") -> bytes:
    return b"".join(field(1, each) for each in inputs) + field(2, output) + field(4, kind) + attributes


def value(name: str, shape: Sequence[int]) -> bytes:
    dimensions = b"".join(field(1, field(1, side)) for side in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dimensions)))


def write_detector(
    path: Path, boxes: Sequence[Sequence[float]], size: tuple[int, int] = (48, 64), names: Sequence[str] = ()
) -> Path:
    """Write a detector for images of `size` (height, width). Scores are those of `boxes` times the brightest pixel."""
    array = np.array([boxes], np.float32)
    shape = array.shape
    tensor = (
        b"".join(field(1, side) for side in shape) + field(2, FLOAT) + field(8, "boxes") + field(9, array.tobytes())
    )
    mask = np.zeros(shape[-1:], np.float32)
    mask[4] = 1.0  # only scores are multiplied
    keep = (1 - mask).astype(np.float32)
    constants = [tensor] + [
        field(1, len(each)) + field(2, FLOAT) + field(8, name) + field(9, each.tobytes())
        for name, each in (("mask", mask), ("keep", keep))
    ]
    no_dimensions = field(5, field(1, "keepdims") + field(3, 0) + field(20, INT))
    nodes = [
        node("ReduceMax", ["image"], "brightest", no_dimensions),
        node("Mul", ["mask", "brightest"], "bright"),
        node("Add", ["bright", "keep"], "factor"),
        node("Mul", ["boxes", "factor"], "detections"),
    ]
    graph = b"".join(field(1, each) for each in nodes) + field(2, "detector")
    graph += b"".join(field(5, each) for each in constants)
    graph += field(11, value("image", (1, 3, *size))) + field(12, value("detections", shape))
    model = field(1, IR) + field(7, graph) + field(8, field(2, OPSET))
    if names:
        model += field(14, field(1, "names") + field(2, json.dumps(list(names))))
    path.write_bytes(model)
    return path

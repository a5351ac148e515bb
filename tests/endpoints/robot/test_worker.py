"""The process that converts messages, run in a thread."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Sequence

import cv2
import msgspec
import numpy as np
import pytest

from converters import Recipe, TypeRegistry, Wire
from endpoints.robot import worker
from endpoints.robot.worker import Answer, Converted, Decode, Encode, Failed, Request
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type

ID = "0a" * 16
IMAGE = Recipe("sensor_msgs/msg/Image", "png")


@pytest.fixture
def served() -> Iterator[socket.socket]:
    ours, theirs = socket.socketpair()
    thread = threading.Thread(target=worker.serve, args=[theirs])
    thread.start()
    yield ours
    ours.close()
    thread.join(60)
    assert not thread.is_alive(), "it ends when the other end is closed"
    theirs.close()


def ask(sock: socket.socket, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytearray]]:
    worker.send(sock, request, buffers)
    head, results = worker.receive(sock)
    return msgspec.msgpack.decode(head, type=Answer), results


def png() -> bytes:
    return cv2.imencode(".png", np.arange(12, dtype=np.uint8).reshape(3, 4))[1].tobytes()


def test_picture_becomes_cdr_and_text_frame_with_blob(served: socket.socket) -> None:
    codec = TypeRegistry().message(parse_type("sensor_msgs/Image"))
    assert codec.recipe == IMAGE
    raw = f'"{ID}"'.encode()
    answer, (cdr,) = ask(served, Encode(IMAGE, True, [ID]), [raw, png()])
    assert answer == Converted()
    assert cdr == codec.encode(Wire(True, raw, {ID: png()}))
    answer, (text, blob) = ask(served, Decode(IMAGE), [cdr])
    assert isinstance(answer, Converted)
    assert answer.is_blob
    assert msgspec.json.decode(text) == answer.blobs[0]
    assert bytes(codec.encode(Wire(True, raw, {ID: blob}))) == cdr


def test_added_types_are_converted_by_their_recipe(served: socket.socket) -> None:
    registry = TypeRegistry()
    registry.add({"a/msg/Outer": "b/Inner[] inner", "b/msg/Inner": "int32 x 5"})
    codec = registry.message(parse_type("a/Outer"))
    assert sorted(name for name, _ in codec.recipe.added) == ["a/msg/Outer", "b/msg/Inner"]
    _, (cdr,) = ask(served, Encode(codec.recipe, False, []), [b'{"inner":[{}]}'])
    assert cdr == codec.encode(Wire(False, b'{"inner":[{}]}', {}))
    _, (text,) = ask(served, Decode(codec.recipe), [cdr])
    assert text == b'{"inner":[{"x":5}]}'


def test_message_that_does_not_fit_is_refused_and_the_next_is_converted(served: socket.socket) -> None:
    answer, buffers = ask(served, Encode(IMAGE, True, [ID]), [f'"{ID}"'.encode(), b"no picture"])
    assert isinstance(answer, Failed)
    assert (answer.error.code, buffers) == ("conversion", [])
    answer, _ = ask(served, Encode(IMAGE, True, [ID]), [f'"{ID}"'.encode(), png()])
    assert answer == Converted()


def test_too_much_memory_refuses_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    def exhausted(_: Recipe, converters: str) -> None:
        raise MemoryError

    monkeypatch.setattr(worker, "_codec", exhausted)
    answer, _ = worker.convert(Encode(IMAGE, False, []), [b"{}"])
    assert isinstance(answer, Failed)
    assert answer.error.code == "limit_exceeded"

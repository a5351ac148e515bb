"""Workers: shared fairly by users, and replaced when they fail."""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import AsyncIterator, Sequence
from typing import cast

import cv2
import msgspec
import numpy as np
import pytest

from converters import Recipe, Wire
from endpoints.robot import workers as workers_module
from endpoints.robot.worker import Answer, Converted, Encode, Request
from endpoints.robot.workers import Worker, Workers
from rce.errors import ConversionError, LimitExceeded
from rce.protocol.blobs import Buffer
from tests.support.endpoints.raw_robot import eventually

ID = "0a" * 16
IMAGE, STRING = Recipe("sensor_msgs/msg/Image", "png"), Recipe("std_msgs/msg/String", "png")


class FakeWorker:
    """Worker that records whose message it has, and converts when it is told."""

    def __init__(self, begun: list[str]) -> None:
        self._begun = begun
        self.go: queue.SimpleQueue[None] = queue.SimpleQueue()
        self.lock = threading.Lock()

    def call(self, request: Request, buffers: Sequence[Buffer]) -> tuple[Answer, list[bytearray]]:
        self._begun.append(bytes(buffers[0]).decode())
        self.go.get(timeout=60)
        return Converted(), [bytearray(buffers[0])]

    def stop(self) -> None:
        self.go.put(None)

    kill = stop


class Fakes(Workers):
    """Workers that do as they are told."""

    def __init__(self, count: int) -> None:
        super().__init__(count)
        self.begun: list[str] = []
        self.fakes = [FakeWorker(self.begun) for _ in range(count)]
        self._idle = cast(list[Worker], list(self.fakes))
        self._all = list(self._idle)

    def ask(self, user: str, name: str) -> asyncio.Task[Buffer]:
        return asyncio.create_task(self.encode(user, STRING, Wire(False, name.encode(), {})))

    def finish_one(self) -> None:
        for fake in self.fakes:
            fake.go.put(None)


@pytest.fixture
async def real() -> AsyncIterator[Workers]:
    workers = Workers(2)
    yield workers
    workers.close()


async def test_users_take_turns() -> None:
    fakes = Fakes(1)
    asked = [fakes.ask("a", name) for name in ("a1", "a2", "a3")] + [fakes.ask("b", "b1")]
    for count in range(1, 5):
        await eventually(lambda count=count: len(fakes.begun) == count)  # type: ignore[misc]
        fakes.finish_one()
    await asyncio.gather(*asked)
    assert fakes.begun == ["a1", "a2", "b1", "a3"]
    fakes.close()


async def test_one_user_never_has_all_workers() -> None:
    fakes = Fakes(2)
    first, second = fakes.ask("a", "a1"), fakes.ask("a", "a2")
    await eventually(lambda: fakes.begun == ["a1"])
    other = fakes.ask("b", "b1")
    await eventually(lambda: fakes.begun == ["a1", "b1"])
    numbers = fakes.families()[0].samples
    assert {sample.value for sample in numbers} == {2, 1}
    fakes.finish_one()
    await eventually(lambda: len(fakes.begun) == 3)
    fakes.finish_one()
    await asyncio.gather(first, second, other)
    fakes.close()


async def test_message_whose_sender_is_gone_is_not_converted() -> None:
    fakes = Fakes(1)
    first, second, third = (fakes.ask("a", name) for name in ("1", "2", "3"))
    await eventually(lambda: fakes.begun == ["1"])
    second.cancel()
    await asyncio.sleep(0)
    fakes.finish_one()
    fakes.finish_one()
    await asyncio.gather(first, third)
    assert fakes.begun == ["1", "3"]
    fakes.close()


async def test_pictures_are_converted_and_refused_in_a_process(real: Workers) -> None:
    png = cv2.imencode(".png", np.zeros((3, 4), np.uint8))[1].tobytes()
    cdr = await real.encode("a", IMAGE, Wire(True, f'"{ID}"'.encode(), {ID: png}))
    wire = await real.decode("a", IMAGE, cdr)
    assert wire.is_blob
    assert [bytes(memoryview(wire.raw)).decode().strip('"')] == list(wire.blobs)
    assert [bytes(blob[:4]) for blob in wire.blobs.values()] == [b"\x89PNG"]
    with pytest.raises(ConversionError, match="neither PNG nor JPEG"):
        await real.encode("a", IMAGE, Wire(True, f'"{ID}"'.encode(), {ID: b"?"}))


async def test_bad_picture_is_refused_without_a_line_in_the_log(
    real: Workers, capfd: pytest.CaptureFixture[str]
) -> None:
    png = bytearray(cv2.imencode(".png", np.zeros((3, 4), np.uint8))[1].tobytes())
    png[-14] ^= 1  # the checksum of the pixels
    with pytest.raises(ConversionError, match="damaged"):
        await real.encode("a", IMAGE, Wire(True, f'"{ID}"'.encode(), {ID: png}))
    assert capfd.readouterr().err == ""


@pytest.mark.slow
async def test_worker_that_dies_costs_one_message() -> None:
    worker = Worker()
    request, buffers = Encode(STRING, False, []), [b'{"data":"x"}']
    assert (await asyncio.to_thread(worker.call, request, buffers))[0] == Converted()
    worker.kill()
    with pytest.raises(LimitExceeded, match="ended the converter"):
        await asyncio.to_thread(worker.call, request, buffers)
    assert (await asyncio.to_thread(worker.call, request, buffers))[0] == Converted()
    worker.stop()


async def test_conversion_that_takes_too_long_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers_module, "MAX_SECONDS", 1)
    monkeypatch.setattr(workers_module, "PROGRAM", ("-c", "import time; time.sleep(100)"))
    worker = Worker()
    with pytest.raises(LimitExceeded, match="more than 1 s"):
        await asyncio.to_thread(worker.call, Encode(STRING, False, []), [b"{}"])


@pytest.mark.slow
async def test_conversions_of_a_stream_keep_their_order_and_its_state(real: Workers) -> None:
    pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")
    png = cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes()
    cdr = await real.encode("a", IMAGE, Wire(True, f'"{ID}"'.encode(), {ID: png}))
    recipe = Recipe(IMAGE.name, "png", codec="h264", stream="s")
    wires = await asyncio.gather(*(real.decode("a", recipe, cdr, key=number == 2) for number in range(4)))
    heads = [msgspec.json.decode(wire.raw) for wire in wires]
    assert [(head["number"], head["key"]) for head in heads] == [(0, True), (1, False), (2, True), (3, False)]

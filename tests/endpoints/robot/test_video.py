"""Video to and from robots: shared encoders, key frames after drops, and rates that follow the line."""

from __future__ import annotations

import asyncio
import json
from typing import Any, cast

import msgspec
import numpy as np
import pytest

pytest.importorskip("av", reason="needs PyAV: pip install '.[video]'")

from converters import Recipe, TypeRegistry, Wire
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.robot.formats import WorkerCodec
from endpoints.robot.session import RobotSession
from endpoints.robot.streams import Streams
from endpoints.robot.video import STEPS, WAITING, SharedEncoders, VideoPublisher
from endpoints.robot.workers import Workers
from rce.codecs.images import ImageDecoder
from rce.codecs.packed import PackedImage
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError
from rce.protocol.blobs import Buffer
from rce.protocol.names import parse_type
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import Robot

IMAGE = "sensor_msgs/Image"
RECIPE = Recipe("sensor_msgs/msg/Image", "png", codec="h264")
CAMERA = b"c" * 16


class CountingWorkers:
    """Workers whose packets have the number of their stream, without an image."""

    def __init__(self) -> None:
        self.encoded: list[tuple[str, int, bool]] = []  # stream, bit rate, whether it is a key frame
        self.fails = False
        self.gate: asyncio.Event | None = None

    async def decode(self, user: str, recipe: Recipe, cdr: Buffer, *, key: bool = False) -> Wire:
        if self.gate is not None:
            await self.gate.wait()
        if self.fails:
            raise ConversionError("no image")
        number = sum(stream == recipe.stream for stream, *_ in self.encoded)
        self.encoded.append((recipe.stream, recipe.bitrate, key or not number))
        head = PackedImage(codec="h264", number=number, key=key or not number)
        return Wire(False, msgspec.json.encode({**msgspec.to_builtins(head), "data*": "0" * 32}), {"0" * 32: b"data"})


class Line:
    """Socket of a robot that takes pieces while it is open."""

    part = 1 << 16

    def __init__(self) -> None:
        self.open = True
        self.texts: list[dict[str, Any]] = []

    def write(self, piece: Any) -> bool:
        self.texts.append(json.loads(bytes(piece[0])))
        return self.open

    def end(self, reason: str) -> None: ...

    def pause_reading(self, until: asyncio.Future[None]) -> None: ...

    def numbers(self) -> list[tuple[int, bool]]:
        """Return number and key of the packets that were written."""
        heads = [each["data"]["msg"] for each in self.texts if each["type"] == "DM"]
        return [(head["number"], head["key"]) for head in heads]


class Viewer:
    """A robot that receives video."""

    def __init__(self, workers: CountingWorkers, encoders: SharedEncoders, number: int = 0) -> None:
        self.line = Line()
        self.session = RobotSession(f"u/v{number}", cast(Any, None), Streams("i"))
        self.session.features = frozenset({"events"})
        self.session.attach(self.line, "", False, 0.0)
        spec = InterfaceSpec(f"{number:032x}", f"u/v{number}", "in", "PublisherConverter", IMAGE, codec="h264")
        codec = WorkerCodec(RECIPE)
        hops = HopRecorder()
        self.publisher = VideoPublisher(spec, hops, self.session, cast(Workers, workers), lambda: codec, encoders)

    def receive(self, message: Message) -> None:
        self.publisher.receive(message, cast(Any, None))

    def block(self, blocked: bool) -> None:
        self.line.open = not blocked
        if blocked:
            self.session.outbox.pause()
        else:
            self.session.outbox.resume()


def image(number: int = 0) -> Message:
    return Message(CAMERA, str(number), b"image", entered_at=float(number))


async def turns() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_image_is_encoded_once_for_all_viewers_and_each_begins_with_a_key_frame() -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    viewers = [Viewer(workers, encoders, number) for number in range(50)]
    for number in range(3):
        message = image(number)
        for viewer in viewers:
            viewer.receive(message)
        await turns()
    assert len(workers.encoded) == 3
    assert {tuple(viewer.line.numbers()) for viewer in viewers} == {((0, True), (1, False), (2, False))}


async def test_late_viewer_gets_a_key_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    monkeypatch.setattr("endpoints.robot.video.KEY_PAUSE", 0.0)
    first, late = (Viewer(workers, encoders, number) for number in range(2))
    for number in range(2):
        first.receive(image(number))
        await turns()
    for number in range(2, 4):
        message = image(number)
        late.receive(message)
        first.receive(message)
        await turns()
    assert late.line.numbers() == [(2, True), (3, False)]
    assert first.line.numbers() == [(0, True), (1, False), (2, True), (3, False)]


async def test_images_are_left_out_while_the_line_is_full_and_the_rate_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    viewer = Viewer(workers, encoders)
    viewer.receive(image(0))
    await turns()
    viewer.block(True)
    for number in range(1, 20):
        viewer.receive(image(number))
        await turns()
    assert len(workers.encoded) == 1 + WAITING, "nothing is encoded that the line cannot carry"
    assert viewer.publisher.dropped == 19 - WAITING - 1
    viewer.block(False)
    await turns()
    viewer.receive(image(20))
    await turns()
    rates = [rate for _, rate, _ in workers.encoded]
    assert rates[0] == STEPS.highest
    assert rates[-1] == STEPS.highest * STEPS.less
    numbers = viewer.line.numbers()
    assert numbers[: 1 + WAITING] == [(0, True), (1, False), (2, False)]
    assert numbers[1 + WAITING] == (0, True), "another encoder, which begins with a key frame"


async def test_viewer_that_misses_a_packet_of_the_common_encoder_waits_for_a_key_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    monkeypatch.setattr("endpoints.robot.video.KEY_PAUSE", 0.0)
    fast, slow = (Viewer(workers, encoders, number) for number in range(2))
    for number in range(7):
        message = image(number)
        if number in (2, 5):
            slow.block(number == 2)
        fast.receive(message)
        slow.receive(message)
        await turns()
    assert fast.line.numbers() == [(0, True), *[(number, False) for number in range(1, 6)], (6, True)]
    assert slow.line.numbers() == [(0, True), (1, False), (2, False), (3, False), (6, True)]
    assert slow.publisher.dropped == 2


async def test_viewers_stay_together_when_the_encoder_is_slower_than_the_camera() -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    viewers = [Viewer(workers, encoders, number) for number in range(3)]
    workers.gate = asyncio.Event()
    for number in range(12):
        message = image(number)
        for viewer in viewers:
            viewer.receive(message)
            await asyncio.sleep(0)
        if number % 4 == 3:
            workers.gate.set()
            await turns()
            workers.gate = asyncio.Event()
    workers.gate.set()
    await turns()
    assert {tuple(viewer.line.numbers()) for viewer in viewers} == {tuple(viewers[0].line.numbers())}
    assert viewers[0].line.numbers()[0] == (0, True)
    assert len(workers.encoded) == len(viewers[0].line.numbers())


async def test_image_that_cannot_be_encoded_is_reported_and_the_next_one_is_a_key_frame() -> None:
    workers, encoders = CountingWorkers(), SharedEncoders()
    viewer = Viewer(workers, encoders)
    workers.fails = True
    viewer.receive(image(0))
    await turns()
    assert "no image" in viewer.line.texts[-1]["data"]
    workers.fails = False
    viewer.receive(image(1))
    await turns()
    assert viewer.line.numbers() == [(0, True)]
    assert viewer.publisher.backlog() == 0
    viewer.publisher.close()


async def test_viewers_at_other_rates_have_other_encoders_and_unused_ones_are_forgotten() -> None:
    encoders, workers = SharedEncoders(), cast(Workers, CountingWorkers())
    one, same, other = (encoders.encoder(CAMERA, rate, workers, "u", RECIPE) for rate in (0.0, 0.0, 10.0))
    assert one is same
    assert one is not other
    del one, same, other
    assert len(encoders._encoders) == 0


PIXELS = np.tile(np.arange(64, dtype=np.uint8), (48, 3)).reshape(48, 64, 3)
CODEC = TypeRegistry().message(parse_type(IMAGE), "json")


def cdr() -> bytes:
    sizes = {"height": 48, "width": 64, "encoding": "rgb8", "step": 192}
    return CODEC.encode(Wire(False, json.dumps({**sizes, "data*": "b"}).encode(), {"b": PIXELS.tobytes()}))


async def connected(platform: Platform, kinds: tuple[str, str], codec: str) -> tuple[Robot, Robot]:
    """Return a robot that sends images to another one, by interfaces of these kinds; Converters have the codec."""
    robots = await platform.robot("a", "events"), await platform.robot("b", "events")
    for robot in robots:
        await robot.receive()
    for owner, tag, kind in zip("ab", ("out", "in"), kinds, strict=True):
        await robots[0].add(tag, kind, IMAGE, of=owner, **({"codec": codec} if kind.endswith("Converter") else {}))
    await robots[0].connect("a/out", "b/in")
    for robot in robots:
        await robot.receive_all(1)
    return robots


async def test_robot_receives_video_of_images_and_sends_it_back(platform: Platform) -> None:
    sender, viewer = await connected(platform, ("SubscriberForwarder", "PublisherConverter"), "h264")
    frame = {"type": "DM", "data": {"iTag": "out", "type": IMAGE, "msgID": "nil", "msg*": "0a" * 16}}
    decoder, packets = ImageDecoder("h264"), []
    for _ in range(3):
        await sender.send(json.dumps(frame), b"0a" * 16 + cdr())
        head, blob = (await viewer.receive())["data"]["msg"], (await viewer.receive())[32:]
        image = decoder.decode(msgspec.convert(head, PackedImage), blob)
        assert image is not None
        assert np.abs(image.astype(int) - PIXELS).mean() < 6
        packets.append((head, blob))
    assert [head["key"] for head, _ in packets] == [True, False, False]


async def test_video_of_a_robot_is_images_for_others_and_a_gap_is_answered(platform: Platform) -> None:
    sender, receiver = await connected(platform, ("SubscriberConverter", "PublisherForwarder"), "h264")
    from rce.codecs.images import ImageEncoder

    encoder = ImageEncoder("h264")
    packets = [encoder.encode(PIXELS, "rgb8") for _ in range(3)]
    for head, data in (packets[0], packets[1]):
        await sender.data("out", {**msgspec.to_builtins(head), "data*": "0a" * 16}, IMAGE)
        await sender.send(b"0a" * 16 + data)
        assert (await receiver.receive())["type"] == "DM"
        assert len((await receiver.receive())[32:]) == len(cdr())
    head, data = encoder.encode(PIXELS, "rgb8")
    await sender.data("out", {**msgspec.to_builtins(head), "data*": "0a" * 16}, IMAGE)
    await sender.send(b"0a" * 16 + data)
    error = (await sender.receive())["error"]
    assert (error["code"], error["field"], error["fields"]["iTag"]) == ("conversion", "key", "out")


async def test_codec_that_the_type_does_not_have_is_refused(platform: Platform) -> None:
    robot = await platform.robot("a", "events")
    await robot.receive()
    wrong: tuple[tuple[str, str, dict[str, Any], str], ...] = (
        ("h265", IMAGE, {}, "it has h264"),
        ("h264", "std_msgs/String", {}, "there is no codec"),
        ("h264", IMAGE, {"delivery": {"fields": ["header"]}}, "a packet has no fields"),
    )
    for codec, type_name, more, reason in wrong:
        await robot.add("in", "PublisherConverter", type_name, codec=codec, **more)
        assert reason in (await robot.receive())["error"]["message"]
    await robot.add("in", "PublisherForwarder", IMAGE, codec="h264")
    assert "has no codec" in (await robot.receive())["error"]["message"]

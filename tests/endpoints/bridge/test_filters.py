"""Filters of forwarded messages."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.filters import IMAGE, TF, RateLimit, image_decoder, image_encoder, transform_filter
from rce.errors import ConversionError
from rce.protocol.blobs import Buffer

TRANSFORMS = TypeRegistry().message(TF)
PIXELS = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def transforms(*frames: str) -> Buffer:
    listed = [{"header": {"frame_id": "odom"}, "child_frame_id": frame} for frame in frames]
    return TRANSFORMS.encode(Wire(False, msgspec.json.encode({"transforms": listed}), {}))


def frames(cdr: Buffer | None) -> list[str]:
    assert cdr is not None
    return [each["child_frame_id"] for each in msgspec.json.decode(TRANSFORMS.decode(cdr).raw)["transforms"]]


def test_rate_limit_keeps_mean_rate() -> None:
    clock = Clock()
    limit = RateLimit(10, clock)
    passed = 0
    for _ in range(300):  # 30 Hz for 10 s: every third message would be 10 Hz, every fourth 7.5 Hz
        passed += limit.allows()
        clock.now += 1 / 30
    assert 98 <= passed <= 102


def test_rate_limit_allows_no_burst_after_pause() -> None:
    clock = Clock()
    limit = RateLimit(10, clock)
    assert limit.allows()
    clock.now += 60
    assert [limit.allows(), limit.allows(), limit.allows()] == [True, False, False]


def test_rate_limit_of_zero_allows_everything() -> None:
    limit = RateLimit(0, Clock())
    assert all(limit.allows() for _ in range(10))


def test_transforms_are_selected_by_child_frame() -> None:
    choose = transform_filter(["base_link", "/camera"], 0, Clock())
    assert frames(choose(transforms("wheel", "base_link", "camera"))) == ["base_link", "camera"]
    assert choose(transforms("wheel")) is None
    whole = transforms("camera")
    assert choose(whole) is whole


def test_each_transform_has_its_own_rate_limit() -> None:
    clock = Clock()
    choose = transform_filter(["a", "b"], 1, clock)
    assert frames(choose(transforms("a"))) == ["a"]
    assert frames(choose(transforms("a", "b"))) == ["b"]
    clock.now += 1
    assert frames(choose(transforms("a", "b"))) == ["a", "b"]


def image(encoding: str, pixels: np.ndarray) -> Buffer:
    head = {"height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding, "step": pixels[0].nbytes}
    value = {**head, "data": list(pixels.tobytes())}
    return TypeRegistry().message(IMAGE, "json").encode(Wire(False, msgspec.json.encode(value), {}))


def test_png_round_trip() -> None:
    cdr = image("rgb8", PIXELS)
    back = TypeRegistry().message(IMAGE, "json").decode(image_decoder()(image_encoder("png")(cdr)))
    value = msgspec.json.decode(back.raw)
    assert (value["width"], value["height"], value["encoding"]) == (6, 4, "rgb8")


def test_encoding_that_cannot_be_compressed_is_rejected() -> None:
    with pytest.raises(ConversionError):
        image_encoder("jpeg")(image("32FC1", np.zeros((4, 6), np.float32)))

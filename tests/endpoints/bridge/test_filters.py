"""What a bridge does to messages on their way."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.bridge.filters import IMAGE, TF, Pace, as_picture, chosen_transforms, from_picture
from rce.blobs import Buffer
from rce.errors import ConversionError

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


def test_a_pace_keeps_the_mean_rate() -> None:
    clock = Clock()
    pace = Pace(10, clock)
    passed = 0
    for _ in range(300):  # 30 a second, for 10 s: every third would be 10 a second, every fourth 7.5
        passed += pace.due()
        clock.now += 1 / 30
    assert 98 <= passed <= 102


def test_after_a_silence_nothing_is_made_up_for() -> None:
    clock = Clock()
    pace = Pace(10, clock)
    assert pace.due()
    clock.now += 60
    assert [pace.due(), pace.due(), pace.due()] == [True, False, False]


def test_without_a_rate_everything_passes() -> None:
    pace = Pace(0, Clock())
    assert all(pace.due() for _ in range(10))


def test_transforms_are_chosen_by_their_child_frames() -> None:
    choose = chosen_transforms(["base_link", "/camera"], 0, Clock())
    assert frames(choose(transforms("wheel", "base_link", "camera"))) == ["base_link", "camera"]
    assert choose(transforms("wheel")) is None
    whole = transforms("camera")
    assert choose(whole) is whole


def test_each_transform_has_its_own_pace() -> None:
    clock = Clock()
    choose = chosen_transforms(["a", "b"], 1, clock)
    assert frames(choose(transforms("a"))) == ["a"]
    assert frames(choose(transforms("a", "b"))) == ["b"]
    clock.now += 1
    assert frames(choose(transforms("a", "b"))) == ["a", "b"]


def image(encoding: str, pixels: np.ndarray) -> Buffer:
    head = {"height": pixels.shape[0], "width": pixels.shape[1], "encoding": encoding, "step": pixels[0].nbytes}
    value = {**head, "data": list(pixels.tobytes())}
    return TypeRegistry().message(IMAGE, "json").encode(Wire(False, msgspec.json.encode(value), {}))


def test_a_png_comes_back_as_it_was() -> None:
    cdr = image("rgb8", PIXELS)
    back = TypeRegistry().message(IMAGE, "json").decode(from_picture()(as_picture("png")(cdr)))
    value = msgspec.json.decode(back.raw)
    assert (value["width"], value["height"], value["encoding"]) == (6, 4, "rgb8")


def test_an_encoding_without_a_picture_format_is_refused() -> None:
    with pytest.raises(ConversionError):
        as_picture("jpeg")(image("32FC1", np.zeros((4, 6), np.float32)))

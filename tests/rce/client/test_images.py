"""Conversion of image files to and from arrays."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from rce.client import images
from rce.errors import ConversionError, InvalidRequest

rng = np.random.default_rng(1)


@pytest.mark.parametrize("shape", [(7, 5), (7, 5, 3), (7, 5, 4)])
def test_png_preserves_every_pixel(shape: tuple[int, ...]) -> None:
    array = rng.integers(0, 256, shape, np.uint8)
    decoded = images.decode(images.encode(array))
    assert decoded.dtype == np.uint8
    np.testing.assert_array_equal(decoded, array)


def test_png_preserves_16_bit_depth() -> None:
    depth = rng.integers(0, 65536, (6, 4), np.uint16)
    decoded = images.decode(images.encode(depth))
    assert decoded.dtype == np.uint16
    np.testing.assert_array_equal(decoded, depth)


def test_single_channel_axis_is_dropped_and_views_are_accepted() -> None:
    array = rng.integers(0, 256, (8, 8, 1), np.uint8)
    np.testing.assert_array_equal(images.decode(images.encode(array[::2, ::-1])), array[::2, ::-1, 0])


def test_jpeg_is_similar_and_quality_determines_its_size() -> None:
    ramp = np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (64, 1))
    color = np.stack([ramp, ramp.T, ramp], axis=2)
    for array in (ramp, color):
        blob = images.encode(array, "jpeg")
        assert blob[:2] == b"\xff\xd8"
        assert np.abs(images.decode(blob).astype(int) - array).mean() < 4
    assert len(images.encode(color, "jpeg", quality=10)) < len(images.encode(color, "jpeg", quality=95))


@pytest.mark.parametrize(
    ("array", "image_format"),
    [
        (np.zeros((4, 4)), "png"),
        (np.zeros((4, 4, 2), np.uint8), "png"),
        (np.zeros((4, 4, 4), np.uint8), "jpeg"),
        (np.zeros((4, 4), np.uint16), "jpeg"),
        (np.zeros(4, np.uint8), "png"),
        (np.zeros((0, 4), np.uint8), "png"),
    ],
)
def test_unsupported_array_is_rejected(
    array: np.ndarray[tuple[int, ...], np.dtype[np.generic]], image_format: str
) -> None:
    with pytest.raises(InvalidRequest, match="uint8"):
        images.encode(array, image_format)  # type: ignore[arg-type]


@pytest.mark.parametrize("blob", [b"", b"not an image", images.encode(np.zeros((9, 9), np.uint8))[:40]])
def test_unreadable_file_is_rejected(blob: bytes) -> None:
    with pytest.raises(ConversionError, match="PNG or JPEG"):
        images.decode(blob)


def test_import_error_names_the_missing_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    monkeypatch.delitem(sys.modules, "rce.client.images")
    with pytest.raises(ImportError, match=r"\.\[images\]"):
        import rce.client.images  # noqa: F401

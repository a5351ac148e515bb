"""A user's own network: a tiny model that the test writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.recognition.network import Network, _names
from tests.support.onnx_model import write_detector

pytest.importorskip("onnxruntime", reason="needs the extra `onnx`")

BOXES = [(8.0, 12.0, 32.0, 24.0, 1.0, 1.0), (0.0, 0.0, 10.0, 10.0, 0.3, 0.0)]
WHITE = np.full((480, 640, 3), 255, np.uint8)


def test_boxes_are_those_of_the_image_with_names(tmp_path: Path) -> None:
    network = Network(write_detector(tmp_path / "cups.onnx", BOXES, names=["plate", "cup"]))
    (found,) = network.find(WHITE)
    assert (found.label, found.score) == ("cup", pytest.approx(1.0))
    assert found.corners == pytest.approx((80.0, 120.0, 320.0, 240.0))
    assert network.find(np.zeros_like(WHITE)) == []


def test_threshold_and_numbers_of_classes(tmp_path: Path) -> None:
    found = Network(write_detector(tmp_path / "cups.onnx", BOXES), threshold=0.2).find(WHITE)
    assert [each.label for each in found] == ["1", "0"]


def test_other_models_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        Network(tmp_path / "none.onnx")
    (tmp_path / "rubbish.onnx").write_bytes(b"rubbish")
    with pytest.raises(InvalidRequest, match="no model that onnxruntime runs"):
        Network(tmp_path / "rubbish.onnx")
    five = Network(write_detector(tmp_path / "five.onnx", [(0.0,) * 5]))
    with pytest.raises(InvalidRequest, match=r"shape \[1, 1, 5\]"):
        five.find(WHITE)


def test_names_may_be_a_list_or_an_object() -> None:
    assert _names('["a", "b"]') == {0: "a", 1: "b"}
    assert _names("{0: 'a', 5: 'f'}") == {0: "a", 5: "f"}
    assert _names("rubbish") == _names("") == {}

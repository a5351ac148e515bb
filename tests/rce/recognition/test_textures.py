"""Textured objects."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.recognition.textures import METHODS, TextureFinder, TextureModel, read_model
from tests.support.plane_scenes import texture, turned, view

WHERE = np.array([0.05, 0.0, 0.7])
BOX, BOOK = TextureModel("box", texture(1), 0.3), TextureModel("book", texture(2), 0.2)


@pytest.mark.parametrize("method", METHODS)
def test_object_is_told_from_another_one(method: str) -> None:
    scene = view(BOX.picture, BOX.width, turned(0.2, -0.3, 0.4), WHERE)
    (found,) = TextureFinder([BOOK, BOX], method).find(scene)
    assert found.model is BOX
    assert len(found.points) == len(found.pixels) >= 15
    assert found.score > 0.5
    assert TextureFinder([BOOK], method).find(scene) == []


def test_points_of_a_picture_are_metres() -> None:
    corners = BOX.points(np.array([(-0.5, -0.5), (299.5, 199.5)]))
    assert corners == pytest.approx(np.array([(-0.15, 0.1, 0.0), (0.15, -0.1, 0.0)]))
    assert BOX.height == pytest.approx(0.2)


def test_picture_without_features_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="the picture of wall has 0 features"):
        TextureFinder([TextureModel("wall", np.full((100, 100), 128, np.uint8), 1.0)])
    with pytest.raises(InvalidRequest, match="orb, sift"):
        TextureFinder([], "surf")
    assert TextureFinder([BOX]).find(np.full((100, 100), 128, np.uint8)) == []


def test_model_is_read_from_its_file(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "front.png"), BOX.picture)
    file = tmp_path / "model.yaml"
    file.write_text("image: front.png\nwidth: 0.3\n")
    model = read_model("box", file)
    assert (model.name, model.width, model.picture.shape) == ("box", 0.3, (200, 300))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not YAML"),
        ("- 1", "`image` must be"),
        ("image: ../front.png\nwidth: 1", "`image` must be"),
        ("image: front.png\nwidth: wide", "`width` is 'wide'"),
        ("image: none.png\nwidth: 1", "missing or not an image"),
    ],
)
def test_file_that_is_no_model_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "model.yaml").write_text(text)
    with pytest.raises(InvalidRequest, match=said):
        read_model("box", tmp_path / "model.yaml")
    with pytest.raises(NotFound):
        read_model("box", tmp_path / "none.yaml")

"""Parameters of the recogniser node, and the models that they name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from rce.api.knowledge_requests import AddEntry
from rce.errors import InvalidRequest, NotFound
from tests.support.environment_knowledge import direct_knowledge
from tests.support.knowledge import new_entry
from tests.support.plane_scenes import texture


def write_model(directory: Path) -> Path:
    directory.mkdir()
    cv2.imwrite(str(directory / "front.png"), texture(1))
    (directory / "model.yaml").write_text("image: front.png\nwidth: 0.3\n")
    return directory / "model.yaml"


def test_models_come_from_files_and_from_the_repository(start_ros: Callable[..., None], tmp_path: Path) -> None:
    import rclpy
    from rce_recognition.parameters import network_of, settings_of

    model = write_model(tmp_path / "box")
    words = ("dictionaries:=[apriltag_36h11]", "sizes:=['qr/tea=0.05']", "features:=sift", "network:=~/cups.onnx")
    start_ros(*words, f"models:=['{model}']", "objects:=[cup.blue]")
    node = rclpy.create_node("recogniser")
    with direct_knowledge(tmp_path / "knowledge") as knowledge:
        knowledge.ask(AddEntry(new_entry()))
        for file in model.parent.iterdir():
            knowledge.put_file("object", "cup.blue", file.name, file.read_bytes())
        settings = settings_of(node, knowledge)
    assert [(each.name, each.width) for each in settings.models] == [("box", 0.3), ("cup.blue", 0.3)]
    assert (list(settings.dictionaries), settings.sizes) == (["apriltag_36h11"], {"qr/tea": 0.05})
    assert (settings.method, settings.marker_size, settings.qr) == ("sift", 0.1, False)
    assert network_of(node) == (Path.home() / "cups.onnx", 0.5)


def test_object_without_a_model_is_told(interfaces: None, tmp_path: Path) -> None:
    from rce_recognition.parameters import fetch_models

    with direct_knowledge(tmp_path) as knowledge:
        knowledge.ask(AddEntry(new_entry()))
        with pytest.raises(NotFound, match=r"no file model\.yaml"):
            fetch_models(["cup.blue"], knowledge)
        with pytest.raises(NotFound):
            fetch_models(["cup.red"], knowledge)


@pytest.mark.parametrize("pair", ["tea", "=0.1", "qr/tea=wide", "qr/tea=-1"])
def test_wrong_size_is_refused(interfaces: None, pair: str) -> None:
    from rce_recognition.parameters import sizes_of

    with pytest.raises(InvalidRequest, match="NAME=METRES"):
        sizes_of([pair])

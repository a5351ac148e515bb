"""Parameters of the recogniser node, and the models that they name."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from rce_mapping.parameters import choice, flag, number, text, texts
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.node import Node

from rce.client.environment_knowledge import EnvironmentKnowledge
from rce.errors import InvalidRequest, NotFound
from rce.recognition.recogniser import RecogniserSettings
from rce.recognition.textures import METHODS, MODEL, TextureModel, read_model

NUMBERS = {  # default, lowest and highest value, description
    "marker_size": (0.1, 0.001, 100.0, "Side of a marker with its black border, metres."),
    "qr_size": (0.1, 0.001, 100.0, "Side of a QR code without its white border, metres."),
    "threshold": (0.5, 0.0, 1.0, "Lowest score of the boxes of the network."),
}
LISTS = {
    "dictionaries": "Dictionaries of markers, such as apriltag_36h11 or 4x4_50.",
    "sizes": "Sides of single fiducials as NAME=METRES, such as apriltag_36h11/3=0.15.",
    "objects": "Uids of objects of the knowledge repository whose file model.yaml names a picture and its width.",
    "models": "Paths of such files.",
}


def settings_of(node: Node, knowledge: EnvironmentKnowledge | None = None) -> RecogniserSettings:
    """Declare all parameters but those of the network, all read-only, and return the settings with their models.

    Raises:
        InvalidRequest: A size or a model is wrong.
        NotFound: A model does not exist.
        Unavailable: Objects are given, and the knowledge service cannot be reached.
    """
    for name, (default, low, high, description) in NUMBERS.items():
        limits = [FloatingPointRange(from_value=low, to_value=high, step=0.0)]
        about = ParameterDescriptor(description=description, floating_point_range=limits, read_only=True)
        node.declare_parameter(name, default, about)
    about = ParameterDescriptor(description=f"Features of objects: {', '.join(METHODS)}.", read_only=True)
    node.declare_parameter("features", METHODS[0], about)
    node.declare_parameter("qr", False, ParameterDescriptor(description="Recognise QR codes.", read_only=True))
    about = ParameterDescriptor(description="Path of a network as an ONNX file; empty for none.", read_only=True)
    node.declare_parameter("network", "", about)
    given = {name: texts(node, name, description) for name, description in LISTS.items()}
    models = [read_model(Path(each).parent.name or each, Path(each)) for each in given["models"]]
    if given["objects"]:
        models += fetch_models(given["objects"], knowledge or EnvironmentKnowledge())
    return RecogniserSettings(
        dictionaries=given["dictionaries"],
        marker_size=number(node, "marker_size"),
        sizes=sizes_of(given["sizes"]),
        qr=flag(node, "qr"),
        qr_size=number(node, "qr_size"),
        models=models,
        method=choice(node, "features", list(METHODS)),
    )


def network_of(node: Node) -> tuple[Path, float] | None:
    """Return the path of the network and its threshold; None without one."""
    path = text(node, "network")
    return (Path(path).expanduser(), number(node, "threshold")) if path else None


def sizes_of(pairs: Sequence[str]) -> dict[str, float]:
    """Return sizes by names.

    Raises:
        InvalidRequest: One is not NAME=METRES.
    """
    sizes: dict[str, float] = {}
    for pair in pairs:
        name, _, size = pair.rpartition("=")
        try:
            sizes[name] = float(size)
        except ValueError:
            sizes[name] = 0.0
        if not name or not 0 < sizes[name] <= 100:
            raise InvalidRequest(f"the parameter sizes has {pair!r}; it must be NAME=METRES", field="sizes")
    return sizes


def fetch_models(uids: Sequence[str], knowledge: EnvironmentKnowledge) -> list[TextureModel]:
    """Return the models of objects of the repository.

    Raises:
        NotFound: There is no such object, or it has no model.
        InvalidRequest: The model is wrong.
        Unavailable: The knowledge service cannot be reached.
    """
    models = []
    for uid in uids:
        found = knowledge.find("object", uid)
        if MODEL not in found.files:
            raise NotFound(f"the object {uid} has no file {MODEL}", field="objects")
        with tempfile.TemporaryDirectory() as directory:
            for name in found.files:
                if name == MODEL or name.lower().endswith((".png", ".jpg", ".jpeg")):
                    (Path(directory) / name).write_bytes(knowledge.read("object", found, name))
            models.append(read_model(uid, Path(directory) / MODEL))
    return models

"""A user's own detector as an ONNX file; needs the extra `onnx`.

The model has one input, float32 (1, 3, height, width): red, green and blue from 0 to 1, of any fixed size to which the
image is stretched. Its one output is float32 (1, n, 6) or (n, 6): left, upper, right and lower edge of a box in pixels
of the input, score, and number of the class. That is what detectors give that were exported with their suppression of
overlapping boxes. The metadata `names` of the model may name the classes: a JSON list, or an object by number.
"""

from __future__ import annotations

import ast
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rce.errors import InvalidRequest, NotFound, Unavailable
from rce.recognition.camera import Floats, Picture

FLOAT = "tensor(float)"


@dataclass(frozen=True, eq=False)
class Box:
    """Object in an image.

    Attributes:
        label: Its class.
        score: 0 to 1.
        corners: (4,) left, upper, right and lower edge, pixels of the image.
    """

    label: str
    score: float
    corners: Floats


class Network:
    """Detector in an ONNX file."""

    def __init__(self, path: Path, threshold: float = 0.5) -> None:
        """Load a model; boxes with a score below the threshold are left out.

        Raises:
            Unavailable: The extra `onnx` is not installed.
            NotFound: There is no such file.
            InvalidRequest: It is no ONNX model, or has other inputs and outputs.
        """
        try:
            import onnxruntime
        except ImportError:
            raise Unavailable("a network needs onnxruntime: pip install 'rce[onnx]'") from None
        if not path.is_file():
            raise NotFound(f"no such model: {path}", field="network")
        try:
            self._session: Any = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        except Exception as error:  # noqa: BLE001  # onnxruntime has no common class of its errors
            raise InvalidRequest(f"{path} is no model that onnxruntime runs: {error}", field="network") from None
        self._threshold = threshold
        inputs, outputs = self._session.get_inputs(), self._session.get_outputs()
        shape = inputs[0].shape if inputs else []
        if (
            (len(inputs), len(outputs), inputs[0].type, len(shape)) != (1, 1, FLOAT, 4)
            or list(shape[:2]) != [1, 3]
            or not all(isinstance(side, int) for side in shape)
        ):
            said = f"{len(inputs)} inputs, the first {inputs[0].type} {shape}, and {len(outputs)} outputs"
            raise InvalidRequest(
                f"{path} has {said}; it must have one input {FLOAT} [1, 3, height, width] and one output",
                field="network",
            )
        self._input, (self._height, self._width) = inputs[0].name, shape[2:]
        self._names = _names(self._session.get_modelmeta().custom_metadata_map.get("names", ""))

    def find(self, picture: Picture) -> list[Box]:
        """Return the boxes in an image of colours.

        Raises:
            InvalidRequest: The output of the model has another shape.
        """
        resized = cv2.resize(picture, (self._width, self._height), interpolation=cv2.INTER_AREA)
        given = np.ascontiguousarray(resized.transpose(2, 0, 1)[None], np.float32) / np.float32(255)
        (output,) = self._session.run(None, {self._input: given})
        rows = np.asarray(output, np.float64)
        if rows.ndim == 3 and rows.shape[0] == 1:
            rows = rows[0]
        if rows.ndim != 2 or rows.shape[1] != 6:
            raise InvalidRequest(f"the output of the network has the shape {list(np.shape(output))}, not [1, n, 6]")
        height, width = picture.shape[:2]
        scale = np.array([width / self._width, height / self._height] * 2)
        good = rows[np.isfinite(rows).all(axis=1) & (rows[:, 4] >= self._threshold)]
        return [Box(self._label(int(row[5])), float(row[4]), row[:4] * scale) for row in good]

    def _label(self, number: int) -> str:
        return self._names.get(number, str(number))


def _names(text: str) -> dict[int, str]:
    """Return the names of classes of a model's metadata; empty without any, or if they are something else."""
    for read in (json.loads, ast.literal_eval):  # some tools write the text of a Python object
        try:
            found = read(text)
        except (ValueError, SyntaxError):
            continue
        if isinstance(found, list):
            found = dict(enumerate(found))
        if isinstance(found, dict):
            return {int(key): str(name) for key, name in found.items() if str(key).isdigit()}
    return {}

"""Textured plane objects, recognised by ORB or SIFT features of a picture of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from rce.errors import InvalidRequest, NotFound
from rce.recognition.camera import Floats, Picture

METHODS = ("orb", "sift")
MODEL = "model.yaml"  # file of an object with the name of its picture and its size
MAX_YAML = 10_000  # bytes
MODEL_FEATURES, SCENE_FEATURES = 1000, 3000
RATIO = 0.8  # Lowe, Distinctive Image Features from Scale-Invariant Keypoints, 2004
SPREAD = 4.0  # pixels by which a point may be off
MIN_INLIERS = 15  # points that must agree


@dataclass(frozen=True, eq=False)
class TextureModel:
    """Picture of one side of an object.

    Attributes:
        name: Name of the object.
        picture: Grey, seen from the front.
        width: Metres.
    """

    name: str
    picture: Picture
    width: float

    @property
    def height(self) -> float:
        """Metres."""
        rows, columns = self.picture.shape
        return float(self.width * rows / columns)

    def points(self, pixels: Floats) -> Floats:
        """Return points (n, 3) of the object, metres, for pixels (n, 2) of the picture."""
        rows, columns = self.picture.shape
        centred = (pixels - (columns / 2 - 0.5, rows / 2 - 0.5)) * (self.width / columns)
        return np.stack([centred[:, 0], -centred[:, 1], np.zeros(len(pixels))], axis=1)


@dataclass(frozen=True, eq=False)
class TextureMatch:
    """Object in an image.

    Attributes:
        model: Its model.
        points: (n, 3) of the object that were found, metres.
        pixels: (n, 2) where they are.
        score: Share of the matches that agree.
    """

    model: TextureModel
    points: Floats
    pixels: Floats
    score: float


class TextureFinder:
    """Finds objects by their features."""

    def __init__(self, models: Sequence[TextureModel], method: str = METHODS[0]) -> None:
        """Describe the models.

        Raises:
            InvalidRequest: A picture has too few features, or there is no such method.
        """
        if method not in METHODS:
            raise InvalidRequest(f"there is no method {method[:80]!r} of features; use one of {', '.join(METHODS)}")
        make: Any = getattr(cv2, "ORB_create" if method == "orb" else "SIFT_create")  # missing in the stubs
        self._norm = cv2.NORM_HAMMING if method == "orb" else cv2.NORM_L2
        self._scene = make(SCENE_FEATURES)
        describe = make(MODEL_FEATURES)
        self._known = [(model, *_features(describe, model.picture)) for model in models]
        for model, pixels, _ in self._known:
            if len(pixels) < MIN_INLIERS:
                raise InvalidRequest(f"the picture of {model.name} has {len(pixels)} features, too few to recognise it")

    def find(self, picture: Picture) -> list[TextureMatch]:
        """Return the objects in a grey image, each at most once."""
        pixels, descriptors = _features(self._scene, picture)
        if not self._known or len(pixels) < MIN_INLIERS:
            return []
        found = (self._match(*known, pixels, descriptors) for known in self._known)
        return [each for each in found if each is not None]

    def _match(
        self, model: TextureModel, own: Floats, described: Any, pixels: Floats, descriptors: Any
    ) -> TextureMatch | None:
        pairs = cv2.BFMatcher(self._norm).knnMatch(described, descriptors, k=2)
        good = [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < RATIO * pair[1].distance]
        if len(good) < MIN_INLIERS:
            return None
        here, there = own[[each.queryIdx for each in good]], pixels[[each.trainIdx for each in good]]
        view, inliers = cv2.findHomography(here, there, cv2.USAC_MAGSAC, SPREAD)
        if view is None or inliers.sum() < MIN_INLIERS:
            return None
        chosen = inliers.ravel().astype(bool)
        return TextureMatch(model, model.points(here[chosen]), there[chosen], float(chosen.mean()))


def read_model(name: str, path: Path) -> TextureModel:
    """Return the model that a file `model.yaml` describes: `image`, a file beside it, and `width` in metres.

    Raises:
        NotFound: A file is missing.
        InvalidRequest: One is not what it should be.
    """
    if not path.is_file():
        raise NotFound(f"no such model: {path}", field="model")
    described = path.read_bytes()[:MAX_YAML]
    try:
        fields = yaml.safe_load(described)
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"{path} is not YAML: {error}", field="model") from None
    image, width = (fields.get("image"), fields.get("width")) if isinstance(fields, dict) else (None, None)
    if not isinstance(image, str) or Path(image).name != image:
        raise InvalidRequest(f"{path}: `image` must be the name of a file beside it", field="image")
    if isinstance(width, bool) or not isinstance(width, int | float) or not 0.001 <= width <= 100:
        raise InvalidRequest(f"{path}: `width` is {width!r}; it must be metres from 0.001 to 100", field="width")
    picture = cv2.imread(str(path.with_name(image)), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise InvalidRequest(f"{path.with_name(image)} is missing or not an image", field="image")
    return TextureModel(name, np.asarray(picture, np.uint8), float(width))


def _features(detector: Any, picture: Picture) -> tuple[Floats, Any]:
    """Return pixels (n, 2) and descriptors of the features of a grey image."""
    points, descriptors = detector.detectAndCompute(picture, None)
    return np.array([each.pt for each in points], np.float64).reshape(-1, 2), descriptors

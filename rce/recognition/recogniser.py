"""All that is recognised in an image, with poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rce.recognition.camera import Camera, Floats, Picture, grey
from rce.recognition.fiducials import Fiducial, MarkerFinder, QrFinder
from rce.recognition.poses import ObjectPose, find_pose, rectangle
from rce.recognition.textures import METHODS, TextureFinder, TextureModel


@dataclass(frozen=True)
class RecogniserSettings:
    """Kinds of things that are recognised.

    Attributes:
        dictionaries: Names of the dictionaries of markers.
        marker_size: Side of a marker with its black border, metres.
        sizes: Side of single fiducials by name, metres.
        qr: Whether QR codes are recognised.
        qr_size: Side of a QR code without its white border, metres.
        models: Textured objects.
        method: Features of textured objects, `orb` or `sift`.
    """

    dictionaries: Sequence[str] = ()
    marker_size: float = 0.1
    sizes: Mapping[str, float] = field(default_factory=dict)
    qr: bool = False
    qr_size: float = 0.1
    models: Sequence[TextureModel] = ()
    method: str = METHODS[0]


@dataclass(frozen=True, eq=False)
class Detection:
    """Object that was recognised.

    Attributes:
        name: Name of the fiducial or of the model.
        score: 0 to 1; of a fiducial 1, since its code was read.
        pose: In the frame of the camera.
        size: Width and height of the object, metres.
    """

    name: str
    score: float
    pose: ObjectPose
    size: tuple[float, float]


class Recogniser:
    """Recognises fiducials and textured objects."""

    def __init__(self, settings: RecogniserSettings) -> None:
        """Prepare what is to be recognised.

        Raises:
            InvalidRequest: There is no such dictionary or method, or a model has too few features.
        """
        self._settings = settings
        self._markers = [MarkerFinder(name) for name in settings.dictionaries]
        self._codes = QrFinder() if settings.qr else None
        self._textures = TextureFinder(settings.models, settings.method)

    def find(self, picture: Picture, camera: Camera) -> list[Detection]:
        """Return what is in an image that has no distortion."""
        scene = grey(picture)
        found = [
            self._fiducial(each, self._settings.marker_size, camera)
            for every in self._markers
            for each in every.find(scene)
        ]
        if self._codes is not None:
            found += [self._fiducial(each, self._settings.qr_size, camera) for each in self._codes.find(scene)]
        for match in self._textures.find(scene):
            size = match.model.width, match.model.height
            found.append(_detection(match.model.name, match.score, match.points, match.pixels, size, camera))
        return [each for each in found if each is not None]

    def _fiducial(self, found: Fiducial, usual: float, camera: Camera) -> Detection | None:
        side = self._settings.sizes.get(found.name, usual)
        return _detection(found.name, 1.0, rectangle(side, side), found.corners, (side, side), camera)


def _detection(
    name: str, score: float, points: Floats, pixels: Floats, size: tuple[float, float], camera: Camera
) -> Detection | None:
    pose = find_pose(points, pixels, camera)
    return None if pose is None else Detection(name, score, pose, size)

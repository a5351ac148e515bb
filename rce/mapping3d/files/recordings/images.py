"""Image files of recordings: reading them, lens distortion, and colour cameras beside the depth camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.frames import Image, RgbdFrame

NO_DEPTH = 65535  # of 16-bit images of some cameras, beside 0
MAX_PIXELS = 50_000_000


def read_color(path: Path) -> Image:
    """Return a colour image (height, width, 3) uint8, red, green, blue.

    Raises:
        InvalidRequest: The file is missing or is no image.
    """
    image = _read(path, cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def read_depth(path: Path, scale: float) -> Depth:
    """Return a depth image (height, width) float32, metres, 0 = none.

    Args:
        path: 16-bit PNG.
        scale: Units of the image in a metre.

    Raises:
        InvalidRequest: The file is missing or is no image of 16 bits.
    """
    image = _read(path, cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InvalidRequest(f"{path.name} is no depth image: 16 bits and one channel are expected", field="path")
    return metres(image.astype(np.uint16), scale)


def metres(image: NDArray[np.uint16], scale: float) -> Depth:
    """Return a depth image of integers in metres."""
    known = np.where(image == NO_DEPTH, np.uint16(0), image)
    depth: Depth = known.astype(np.float32) / np.float32(scale)
    return depth


def _read(path: Path, flags: int) -> NDArray[np.integer | np.floating]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InvalidRequest(f"{path.name} cannot be read: {error.strerror}", field="path") from None
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags) if content else None
    except cv2.error:
        image = None
    if image is None or image.size > 4 * MAX_PIXELS:
        raise InvalidRequest(f"{path.name} is not an image, or is damaged", field="path")
    return image


def checked(frame: RgbdFrame, camera: Camera, what: str) -> RgbdFrame:
    """Return a frame whose images have the size of the camera.

    Raises:
        InvalidRequest: They have another size.
    """
    size = (camera.height, camera.width)
    if frame.depth.shape != size or frame.color.shape[:2] != size:
        shapes = " and ".join(f"{s[1]} x {s[0]}" for s in (frame.color.shape, frame.depth.shape))
        raise InvalidRequest(
            f"{what}: colour and depth have {shapes} pixels, the camera {camera.width} x {camera.height}", field="path"
        )
    return frame


class Undistortion:
    """Removal of the distortion of a lens (model of Brown and Conrady) from colour and registered depth."""

    def __init__(self, camera: Camera, coefficients: Sequence[float]) -> None:
        """Prepare.

        Args:
            camera: The camera, before and after.
            coefficients: k1, k2, p1, p2, k3 and so on, as OpenCV has them.
        """
        size = (camera.width, camera.height)
        matrix = camera.matrix
        self._maps = cv2.initUndistortRectifyMap(
            matrix, np.asarray(coefficients, np.float64), np.eye(3), matrix, size, cv2.CV_32FC1
        )

    def __call__(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame as a camera without distortion sees it."""
        x, y = self._maps
        color = cv2.remap(frame.color, x, y, cv2.INTER_LINEAR)
        depth = cv2.remap(frame.depth, x, y, cv2.INTER_NEAREST)
        return RgbdFrame(frame.stamp, np.asarray(color, np.uint8), np.asarray(depth, np.float32))


@dataclass(frozen=True, slots=True)
class ColorCamera:
    """A colour camera beside the depth camera, which looks in the same direction.

    Attributes:
        camera: Its intrinsics.
        offset: Metres from the centre of the depth camera to the right.
    """

    camera: Camera
    offset: float

    def registered(self, frame: RgbdFrame, depth_camera: Camera) -> RgbdFrame:
        """Return a frame whose colour image shows what the depth camera sees at each pixel.

        Where there is no depth, that of the surroundings is taken: colours without depth serve features only.
        """
        filled = _filled(frame.depth)
        rays = depth_camera.rays()
        x = (rays[:, :, 0] - self.offset / filled) * self.camera.fx + self.camera.cx
        y = rays[:, :, 1] * self.camera.fy + self.camera.cy
        color = cv2.remap(
            frame.color, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return RgbdFrame(frame.stamp, np.asarray(color, np.uint8), frame.depth)


def edge_agreement(frame: RgbdFrame) -> float:
    """Return how much stronger the colour changes at edges of the depth than elsewhere.

    The measure is largest where colours and depths are registered to each other.
    """
    gray = cv2.GaussianBlur(cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY), (0, 0), 1.5).astype(np.float32)
    strength = np.hypot(cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1))
    depth = _filled(frame.depth)
    near, far = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
    edges = (far - near) > 0.1 * near
    if edges.sum() < 100:
        return 0.0
    return float(strength[edges].mean() / max(float(strength.mean()), 1e-6))


def _filled(depth: Depth) -> Depth:
    """Return the depth with holes filled from their surroundings, 2 m where there is none at all."""
    filled = depth
    for size in (5, 15, 45):
        known = (filled > 0).astype(np.float32)
        total = cv2.boxFilter(filled, -1, (size, size), normalize=False)
        count = cv2.boxFilter(known, -1, (size, size), normalize=False)
        filled = np.where(filled > 0, filled, np.where(count > 0.5, total / np.maximum(count, 1.0), np.float32(0)))
    return np.where(filled > 0.1, filled, np.float32(2.0)).astype(np.float32)

"""A simulated room: colour and depth as a camera sees them, with the noise of a Kinect and the faults of a real one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled
from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.files.trajectories import Stamped
from rce.mapping3d.frames import Image, RgbdFrame
from rce.mapping3d.poses import Pose, interpolate, make_pose

QVGA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
TEXELS = 120.0  # of the texture in a metre
TEXTURE = 1024  # texels along the side of the texture, which repeats
# Walls of the room, then furniture: (6,) lower and upper corner, metres; z is up and the floor is at 0.
ROOM = (0.0, 0.0, 0.0, 6.0, 5.0, 2.6)
FURNITURE = (
    (0.6, 0.5, 0.70, 2.4, 1.5, 0.75),  # a table and its legs
    (0.6, 0.5, 0.0, 0.7, 0.6, 0.70),
    (2.3, 0.5, 0.0, 2.4, 0.6, 0.70),
    (0.6, 1.4, 0.0, 0.7, 1.5, 0.70),
    (2.3, 1.4, 0.0, 2.4, 1.5, 0.70),
    (1.0, 0.7, 0.75, 1.3, 1.0, 1.05),  # things on it
    (1.7, 0.9, 0.75, 1.95, 1.2, 0.9),
    (4.6, 0.0, 0.0, 5.6, 0.4, 2.0),  # a shelf
    (5.5, 1.5, 0.0, 6.0, 3.2, 0.9),  # a sideboard
    (0.0, 3.6, 0.0, 0.9, 5.0, 0.5),  # a bed
    (2.6, 4.4, 0.0, 3.6, 5.0, 1.3),
    (3.9, 4.2, 0.0, 4.3, 4.6, 1.8),
)


@dataclass(frozen=True, slots=True)
class Faults:
    """Disturbances of a camera's images.

    Attributes:
        noise: Standard deviation of brightness, 0 to 255.
        depth_noise: Multiple of the noise of depth of a Kinect.
        blur: Share of the time between frames during which the shutter is open.
        exposure: Largest change of the gain, as a share; it swings with a period of 2 s.
        missing: Share of the depth image that is lost, in patches.
        furthest: Metres; there is no depth beyond.
    """

    noise: float = 2.0
    depth_noise: float = 1.0
    blur: float = 0.0
    exposure: float = 0.0
    missing: float = 0.05
    furthest: float = 4.5


@dataclass(frozen=True)
class SimulatedRecording:
    """Frames of a camera that is moved through the room; an `RgbdRecording` with ground truth.

    Attributes:
        name: Name.
        way: Poses of the camera, z of the map up, at the stamps of the frames.
        faults: What the camera does.
        camera: The camera.
        seed: Of the noise.
    """

    name: str
    way: tuple[Stamped, ...]
    faults: Faults = Faults()
    camera: Camera = QVGA
    seed: int = 0

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.way)

    def __iter__(self) -> Iterator[RgbdFrame]:
        """Yield the frames."""
        random = np.random.default_rng(self.seed)
        for number, (stamp, pose) in enumerate(self.way):
            color, depth = render(pose, self.camera)
            if self.faults.blur and number:
                color = self._blurred(color, self.way[number - 1][1], pose)
            yield RgbdFrame(stamp, self._exposed(color, stamp, random), self._measured(depth, random))

    def _blurred(self, color: Image, before: Pose, pose: Pose) -> Image:
        """Return the mean of what the camera sees while the shutter is open, which ends at `pose`."""
        total = color.astype(np.float32)
        steps = 4
        for step in range(1, steps):
            between = interpolate(pose, before, self.faults.blur * step / (steps - 1))
            total += render(between, self.camera)[0]
        return (total / steps).astype(np.uint8)

    def _exposed(self, color: Image, stamp: float, random: np.random.Generator) -> Image:
        gain = 1.0 + self.faults.exposure * math.sin(math.pi * stamp)
        noisy = color * gain + random.normal(0.0, self.faults.noise, color.shape)
        return np.clip(noisy, 0, 255).astype(np.uint8)

    def _measured(self, depth: Depth, random: np.random.Generator) -> Depth:
        """Return the depth with noise and steps of disparity (Khoshelham and Elberink, 2012), holes and edges."""
        height, width = depth.shape
        coarse = random.normal(0.0, 1.0, (height // 2, width // 2)).astype(np.float32)
        noise = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
        sigma = self.faults.depth_noise * (0.0005 + 0.0014 * depth**2)
        noisy = depth + sigma * noise
        disparity = np.round(8.0 * 43.5 / np.maximum(noisy, 0.1)) / 8.0  # 580 pixels x 75 mm, in eighths
        measured = np.where(disparity > 0, 43.5 / np.maximum(disparity, 1e-3), 0.0).astype(np.float32)
        near, far = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
        edges = (far - near > 0.1 * near) & (random.random(depth.shape) < 0.7)
        patches = cv2.resize(random.random((height // 16, width // 16)), (width, height))
        lost = edges | (patches < np.quantile(patches, self.faults.missing)) | (depth > self.faults.furthest)
        return np.where(lost, np.float32(0), measured)


def render(pose: Pose, camera: Camera) -> tuple[Image, Depth]:
    """Return colour (height, width, 3) and depth (height, width) of the room at a pose, without noise."""
    color = np.empty((camera.height, camera.width, 3), np.uint8)
    depth = np.empty((camera.height, camera.width), np.float32)
    boxes = np.array((ROOM, *FURNITURE), np.float64)
    trace(boxes, _TEXTURE, np.ascontiguousarray(pose), camera.rays(), color, depth)
    return color, depth


def look(position: tuple[float, float, float], target: tuple[float, float, float], roll: float = 0.0) -> Pose:
    """Return the pose of a camera that looks at a point, turned by `roll` radians about its axis."""
    forward = np.subtract(target, position)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = math.cos(roll), math.sin(roll)
    return make_pose(np.stack([c * right + s * down, c * down - s * right, forward], axis=1), position)


def sweep(seconds: float, speed: float = 1.0, begin: float = 0.0, rate: float = 30.0) -> tuple[Stamped, ...]:
    """Return a way about the table and through the room with the shaking of a hand.

    Args:
        seconds: Length.
        speed: Multiple of a calm speed.
        begin: Seconds of the same way at which this one begins.
        rate: Frames a second.
    """
    way = []
    for number in range(int(seconds * rate)):
        stamp = number / rate
        t = speed * stamp + begin
        around = 0.35 * t
        position = (
            3.0 + 1.2 * math.cos(around) + 0.02 * math.sin(7.0 * t),
            2.5 + 0.9 * math.sin(around) + 0.02 * math.sin(5.3 * t),
            1.4 + 0.15 * math.sin(0.9 * t),
        )
        target = (
            3.0 - 2.4 * math.cos(around + 0.5 * math.sin(0.6 * t)),
            2.4 - 2.0 * math.sin(around + 0.5 * math.sin(0.6 * t)),
            0.8 + 0.25 * math.sin(1.1 * t),
        )
        way.append((stamp, look(position, target, 0.08 * math.sin(1.7 * t))))
    return tuple(way)


@compiled(
    "void(float64[:,::1], uint8[:,:,::1], float64[:,::1], Array(float32, 3, 'C', readonly=True), "
    "uint8[:,:,::1], float32[:,::1])"
)
def trace(
    boxes: NDArray[np.float64],
    texture: Image,
    pose: NDArray[np.float64],
    rays: NDArray[np.float32],
    color: Image,
    depth: Depth,
) -> None:
    """Cast the ray of each pixel to the nearest face (Kay and Kajiya, Ray Tracing Complex Scenes, 1986).

    Args:
        boxes: (n, 6) lower and upper corners, metres; the first is the room, seen from inside.
        texture: (size, size, 3), repeated over all faces.
        pose: (4, 4) camera to map.
        rays: (height, width, 3) from `Camera.rays`.
        color: (height, width, 3), set.
        depth: (height, width) metres, set.
    """
    size = texture.shape[0]
    direction, hit = np.zeros(3), np.zeros(3)
    for row in range(rays.shape[0]):
        for column in range(rays.shape[1]):
            for k in range(3):
                direction[k] = pose[k, 0] * rays[row, column, 0] + pose[k, 1] * rays[row, column, 1] + pose[k, 2]
            nearest, axis, box = 1e9, 0, 0
            for number in range(boxes.shape[0]):
                enter, leave, enter_axis, leave_axis = -1e9, 1e9, 0, 0
                for k in range(3):
                    if abs(direction[k]) < 1e-12:
                        if not boxes[number, k] <= pose[k, 3] <= boxes[number, k + 3]:
                            enter = 1e9
                        continue
                    first = (boxes[number, k] - pose[k, 3]) / direction[k]
                    second = (boxes[number, k + 3] - pose[k, 3]) / direction[k]
                    if first > second:
                        first, second = second, first
                    if first > enter:
                        enter, enter_axis = first, k
                    if second < leave:
                        leave, leave_axis = second, k
                if number == 0:
                    enter, enter_axis = leave, leave_axis
                elif enter > leave:
                    continue
                if 0.05 < enter < nearest:
                    nearest, axis, box = enter, enter_axis, number
            for k in range(3):
                hit[k] = pose[k, 3] + nearest * direction[k]
            u, v = hit[(axis + 1) % 3], hit[(axis + 2) % 3]
            x = math.floor(u * TEXELS) + 131 * (7 * box + axis)
            y = math.floor(v * TEXELS) + 197 * (3 * box + axis)
            shade = 1.0 - 0.12 * axis
            for k in range(3):
                tint = 0.75 + 0.25 * ((5 * box + 3 * axis + 2 * k) % 4) / 3.0
                color[row, column, k] = np.uint8(texture[y % size, x % size, k] * shade * tint)
            depth[row, column] = nearest


def _make_texture() -> Image:
    """Return (size, size, 3) of spots of all sizes, rectangles such as pictures and books, and even parts."""
    random = np.random.default_rng(7)
    layers = np.zeros((TEXTURE, TEXTURE, 3), np.float32)
    for cells, strength in ((8, 25.0), (32, 20.0), (128, 14.0), (512, 7.0)):
        spots = random.normal(0.0, 1.0, (cells, cells, 3)).astype(np.float32)
        layers += strength * cv2.resize(spots, (TEXTURE, TEXTURE), interpolation=cv2.INTER_CUBIC)
    image = np.clip(130.0 + layers, 0, 255).astype(np.uint8)
    for _ in range(160):
        x, y = random.integers(0, TEXTURE, 2).tolist()
        w, h = random.integers(6, 60, 2).tolist()
        shade = random.integers(20, 235, 3).tolist()
        cv2.rectangle(image, (x, y), (x + w, y + h), shade, -1)
    return np.ascontiguousarray(cv2.GaussianBlur(image, (0, 0), 0.8))


_TEXTURE = _make_texture()

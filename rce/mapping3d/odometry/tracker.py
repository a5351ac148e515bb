"""Front end: the pose of each frame against the last key frame, the choice of key frames, and loss of track."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import AnyKeyFrame, KeyFrame, RgbdFrame
from rce.mapping3d.odometry.alignment import Alignment, Prior, align
from rce.mapping3d.odometry.pyramid import Level, ReferenceLevel, image_pyramid, reference_pyramid
from rce.mapping3d.places.features import Features, find_features
from rce.mapping3d.places.verification import match_features
from rce.mapping3d.poses import Pose, angle, distance, interpolate, inverse

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrackerSettings:
    """Settings of the front end.

    Attributes:
        angle: Radians from the key frame at which the next one is made.
        distance: Metres, likewise.
        overlap: Share of the points of the key frame still in view, likewise.
        sharpness: A frame with less of the recent sharpness makes no key frame, unless it is needed at once.
        urgent: Multiple of `angle` and `distance` at which a key frame is needed at once.
        least_overlap: With less of the key frame in view track is lost.
        least_fit: With fewer depths that agree track is lost.
        depth_error: With a larger scale of errors of depth, as a multiple of the expected noise, track is lost.
        brightness_error: The same for brightness, 0 to 255.
        least_measured: With fewer points whose depth can be compared, colours decide.
        blind_overlap: `least_overlap` where colours decide.
        gain: Largest change of exposure with which colours count as alike.
        dark_fit: `least_fit` where colours are not alike.
        jump: Metres and radians from the predicted pose, beyond which an alignment has slid to another place.
        least_points: A frame with fewer points cannot be a key frame.
        patience: Frames after which a lost front end starts anew, at a pose without relation to those before.
        acceleration: Standard deviations of the change of motion between frames: metres, radians.
    """

    angle: float = math.radians(3.0)
    distance: float = 0.09
    overlap: float = 0.8
    sharpness: float = 0.6
    urgent: float = 2.5
    least_overlap: float = 0.25
    least_fit: float = 0.6
    depth_error: float = 4.0
    brightness_error: float = 30.0
    least_measured: int = 300
    blind_overlap: float = 0.5
    gain: float = 3.0
    dark_fit: float = 0.85
    jump: tuple[float, float] = (0.3, math.radians(20.0))
    least_points: int = 1500
    patience: int = 10
    acceleration: tuple[float, float] = (0.02, 0.03)


@dataclass(frozen=True, slots=True)
class Tracked:
    """Answer of the front end to a frame.

    Attributes:
        stamp: Stamp of the frame, seconds.
        reference: Index of the key frame that `pose` refers to; -1 before the first one.
        pose: (4, 4) camera of this frame to camera of the key frame.
        information: (6, 6) inverse covariance of the pose: translation, rotation, frame of this camera.
        lost: True if the motion could not be measured: the pose is a guess.
        key: The new key frame that this frame has become, if any.
        linked: False for a key frame whose pose against the one before is a guess.
    """

    stamp: float
    reference: int
    pose: Pose
    information: Floats
    lost: bool = False
    key: AnyKeyFrame | None = None
    linked: bool = True


class Tracker:
    """Front end of one robot.

    Attributes:
        camera: Camera of the frames.
        lost: True while the pose is unknown.
    """

    def __init__(self, camera: Camera, robot: int = 0, settings: TrackerSettings | None = None) -> None:
        """Begin without a key frame.

        Args:
            camera: Camera of the frames.
            robot: Number that key frames get.
            settings: Settings, None for the default.
        """
        self.camera = camera
        self.lost = False
        self._settings = settings or TrackerSettings()
        self._robot = robot
        self._reference: _Reference | None = None
        self._pose = np.eye(4)  # points of the reference to the frame of the last image
        self._motion = np.eye(4)  # points in the frame of the image before the last to that of the last
        self._missed = 0
        self._count = 0
        self._sharpness = 0.0

    def add(self, frame: RgbdFrame) -> Tracked:
        """Return the pose of the next frame."""
        image = image_pyramid(frame, self.camera)
        sharpness = _sharpness(image[1])
        self._sharpness = max(sharpness, 0.95 * self._sharpness)
        if self._reference is None:
            if int((image[0].depth > 0).sum()) < self._settings.least_points:
                return Tracked(frame.stamp, -1, np.eye(4), np.zeros((6, 6)), lost=True)
            return self._begin(frame, image)
        found = self._find(frame, image)
        if found is None:
            return self._miss(frame, image)
        motion = found.pose @ inverse(self._pose)
        self._motion = motion if self._missed == 0 else np.eye(4)
        self._pose, self._missed, self.lost = found.pose, 0, False
        pose = inverse(found.pose)
        if not self._wants_key(found, image, sharpness):
            return Tracked(frame.stamp, self._reference.index, pose, found.information)
        before = self._reference.index
        key = self._make_key(frame, image)
        return Tracked(frame.stamp, before, pose, found.information, key=key)

    def _find(self, frame: RgbdFrame, image: list[Level]) -> Alignment | None:
        """Return the pose of a frame against the reference, from the predicted start, the last pose, or features."""
        assert self._reference is not None
        levels = self._reference.levels
        if self._missed == 0:
            start = self._motion @ self._pose
            found = align(levels, image, start, self._prior(start))
            if self._good(found) and self._near(found, start):
                return found
        found = align(levels, image, self._pose)
        if self._good(found) and self._near(found, self._pose):
            return found
        match = match_features(self._reference.features(), find_features(frame, self.camera), self.camera)
        if match is None:
            return None
        found = align(levels, image, match.pose, first=min(2, len(image) - 1))
        return found if self._good(found) else None

    def _near(self, found: Alignment, start: Pose) -> bool:
        off = found.pose @ inverse(start)
        shift, turn = self._settings.jump
        return distance(off) < shift and angle(off) < turn

    def _prior(self, start: Pose) -> Prior:
        """Return the expectation that motion changes little between frames; it decides what the images leave open."""
        shift, turn = self._settings.acceleration
        return Prior(start, np.diag([1.0 / shift**2] * 3 + [1.0 / turn**2] * 3))

    def _good(self, found: Alignment) -> bool:
        settings = self._settings
        if found.overlap < settings.least_overlap or found.brightness_error > settings.brightness_error:
            return False
        # A gain near 0 means that the colours have nothing in common.
        alike = 1 / settings.gain < found.gain < settings.gain
        if found.measured >= settings.least_measured:
            least = settings.least_fit if alike else settings.dark_fit
            return found.fit >= least and found.depth_error <= settings.depth_error
        return alike and found.overlap >= settings.blind_overlap

    def _wants_key(self, found: Alignment, image: list[Level], sharpness: float) -> bool:
        settings = self._settings
        moved = max(angle(found.pose) / settings.angle, distance(found.pose) / settings.distance)
        moved = max(moved, (1.0 - found.overlap) / (1.0 - settings.overlap))
        if moved < 1.0 or int((image[0].depth > 0).sum()) < settings.least_points:
            return False
        return moved > settings.urgent or sharpness > settings.sharpness * self._sharpness

    def _miss(self, frame: RgbdFrame, image: list[Level]) -> Tracked:
        """Answer a frame whose pose was not found; after some of them begin anew."""
        assert self._reference is not None
        self._missed += 1
        self.lost = True
        if self._missed <= 3:  # the motion goes on for a moment
            self._pose = self._motion @ self._pose
            self._motion = interpolate(np.eye(4), self._motion, 0.5)
        pose, before = inverse(self._pose), self._reference.index
        unknown = np.zeros((6, 6))
        if self._missed < self._settings.patience or int((image[0].depth > 0).sum()) < self._settings.least_points:
            return Tracked(frame.stamp, before, pose, unknown, lost=True)
        key = self._make_key(frame, image)
        self._motion, self._missed, self.lost = np.eye(4), 0, False
        return Tracked(frame.stamp, before, pose, unknown, lost=True, key=key, linked=False)

    def _begin(self, frame: RgbdFrame, image: list[Level]) -> Tracked:
        key = self._make_key(frame, image)
        return Tracked(frame.stamp, -1, np.eye(4), np.zeros((6, 6)), key=key, linked=False)

    def _make_key(self, frame: RgbdFrame, image: list[Level]) -> KeyFrame:
        key = KeyFrame(self._robot, self._count, frame, self.camera)
        self._count += 1
        self._reference = _Reference(key, reference_pyramid(image))
        self._pose = np.eye(4)
        return key


class _Reference:
    """The key frame against which frames are tracked.

    Attributes:
        index: Its index.
        levels: Its points.
    """

    def __init__(self, key: KeyFrame, levels: list[ReferenceLevel]) -> None:
        self.index = key.index
        self.levels = levels
        self._key = key
        self._features: Features | None = None

    def features(self) -> Features:
        """Return its features, found when they are first needed."""
        if self._features is None:
            self._features = find_features(self._key.frame, self._key.camera)
        return self._features


def _sharpness(level: Level) -> float:
    """Return the mean strength of the second derivative, relative to the contrast: motion blur lowers it."""
    second = cv2.Laplacian(level.image, cv2.CV_32F)
    return float(np.abs(second).mean() / (level.image.std() + 1.0))

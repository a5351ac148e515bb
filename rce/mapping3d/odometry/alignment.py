"""Dense alignment of two images with depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rce.mapping3d.odometry.kernels import SIZE, SUMS, linearise
from rce.mapping3d.odometry.pyramid import Level, ReferenceLevel
from rce.mapping3d.poses import Pose, make_pose, rigid

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """Settings of the alignment.

    Attributes:
        iterations: Most Gauss-Newton steps at each size, from the full one to the smallest.
        tolerance: Metres and radians; a smaller step ends the iteration at a size.
        depth_noise: b0, b1 of the standard deviation b0 + b1 z^2 of a depth z, metres (Khoshelham and Elberink,
            Accuracy and Resolution of Kinect Depth Data for Indoor Mapping Applications, 2012).
        registration: Pixels by which colours may be off their depths: the cameras are beside each other, calibrated
            to about a pixel, and do not expose at the same time.
        exposure: Standard deviations of gain (as a ratio) and bias (brightness) that are expected between images.
        correlated: Pixels whose errors count as one in the covariance: neighbours err together.
    """

    iterations: tuple[int, ...] = (6, 8, 10, 12)
    tolerance: float = 1e-4
    depth_noise: tuple[float, float] = (0.001, 0.0019)
    registration: float = 1.5
    exposure: tuple[float, float] = (0.3, 30.0)
    correlated: float = 30.0


SETTINGS = AlignmentSettings()


@dataclass(frozen=True, slots=True)
class Alignment:
    """Result of an alignment.

    Attributes:
        pose: (4, 4) takes points of the reference to the camera frame of the image.
        information: (6, 6) inverse covariance of the pose: translation, rotation in the frame of the image.
        overlap: Share of the points of the reference that lie inside the image.
        fit: Share of the points with depth in both images whose depths agree.
        measured: Number of the points with depth in both images.
        depth_error: Robust scale of the errors of depth, as a multiple of the expected noise.
        brightness_error: Robust scale of the errors of brightness.
        gain: Brightness in the image by brightness in the reference.
    """

    pose: Pose
    information: Floats
    overlap: float
    fit: float
    measured: float
    depth_error: float
    brightness_error: float
    gain: float


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of a pose.

    Attributes:
        pose: (4, 4) takes points of the reference to the camera frame of the image.
        information: (6, 6) inverse covariance: translation, rotation in the frame of the image.
    """

    pose: Pose
    information: Floats


def align(
    reference: Sequence[ReferenceLevel],
    image: Sequence[Level],
    start: Pose,
    prior: Prior | None = None,
    first: int = -1,
    last: int = 0,
) -> Alignment:
    """Return the pose at which the points of a reference fit an image, from small sizes to large ones.

    Iteratively reweighted Gauss-Newton (Kerl, Sturm and Cremers, Dense Visual SLAM for RGB-D Cameras, 2013).

    Args:
        reference: The reference, from the full size on.
        image: The image, likewise.
        start: (4, 4) pose from which the iteration starts; takes points of the reference to the frame of the image.
        prior: What is known beforehand, None for nothing.
        first: Size to start with, -1 for the smallest.
        last: Size to end with.
    """
    state = _State(rigid(start))
    smallest = len(image) - 1 if first < 0 else first
    for size in range(smallest, last - 1, -1):
        _iterate(reference[size], image[size], state, prior, SETTINGS.iterations[size])
    total = len(reference[last].points)
    return Alignment(
        rigid(state.pose),
        state.hessian / SETTINGS.correlated,
        state.sums[0] / max(total, 1),
        state.fit,
        state.measured,
        state.depth_scale,
        state.brightness_scale,
        state.gain,
    )


class _State:
    """Unknowns and scales of an alignment."""

    def __init__(self, pose: Pose) -> None:
        self.pose = pose
        self.gain, self.bias = 1.0, 0.0
        self.brightness_scale, self.depth_scale = 20.0, 5.0
        self.hessian: Floats = np.zeros((6, 6))
        self.sums: Floats = np.zeros(SUMS)
        self.fit = self.measured = 0.0


def _iterate(reference: ReferenceLevel, image: Level, state: _State, prior: Prior | None, steps: int) -> None:
    camera = image.camera
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *SETTINGS.depth_noise, SETTINGS.registration])
    hessian, gradient = np.zeros((SIZE, SIZE)), np.zeros(SIZE)
    for _ in range(steps):
        linearise(
            reference.points,
            reference.normals,
            reference.brightness,
            image.image,
            image.depth,
            intrinsics,
            state.pose,
            state.gain,
            state.bias,
            state.brightness_scale,
            state.depth_scale,
            hessian,
            gradient,
            state.sums,
        )
        _rescale(state)
        # Marginal information about the pose: gain and bias are not asked for.
        matrix, right = hessian.copy(), gradient.copy()
        gain_sigma, bias_sigma = SETTINGS.exposure
        matrix[6, 6] += 1.0 / gain_sigma**2
        matrix[7, 7] += 1.0 / bias_sigma**2
        right[6] += (state.gain - 1.0) / gain_sigma**2
        right[7] += state.bias / bias_sigma**2
        state.hessian = matrix[:6, :6] - matrix[:6, 6:] @ np.linalg.solve(matrix[6:, 6:], matrix[6:, :6])
        if prior is not None:
            off = prior.pose @ np.linalg.inv(state.pose)
            error = -np.concatenate([off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()])
            matrix[:6, :6] += SETTINGS.correlated * prior.information
            right[:6] += SETTINGS.correlated * prior.information @ error
        matrix[range(SIZE), range(SIZE)] += 1e-6 * np.trace(matrix[:6, :6]) / 6 + 1e-9
        step = -np.linalg.solve(matrix, right)
        turn = np.linalg.norm(step[3:6])
        if turn > 0.2:  # radians; no linearisation holds as far
            step *= 0.2 / turn
        state.pose = make_pose(Rotation.from_rotvec(step[3:6]).as_matrix(), step[:3]) @ state.pose
        state.gain += step[6]
        state.bias += step[7]
        if np.abs(step[:6]).max() < SETTINGS.tolerance:
            break


def _rescale(state: _State) -> None:
    """Set the scales of the errors to those of Student's t distribution that fits them, and the share of fits."""
    _, pixels, squares, depths, depth_squares, fitting, measured = state.sums
    if pixels > 0:
        state.brightness_scale = float(np.clip(np.sqrt(squares / pixels), 1.0, 60.0))
    if depths > 0:
        state.depth_scale = float(np.clip(np.sqrt(depth_squares / depths), 0.3, 20.0))
    state.fit, state.measured = fitting / max(measured, 1.0), measured

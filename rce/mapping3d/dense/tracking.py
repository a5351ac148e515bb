"""Dense tracking: each depth image is laid on the surface of all before it, as the volume has it.

Newcombe et al., KinectFusion: Real-Time Dense Surface Mapping and Tracking, 2011. It needs the extra `dense`. The
kernels run on a graphics processor if there is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera, Depth
from rce.mapping3d.dense import tracking_kernels as kernels
from rce.mapping3d.poses import Floats, Pose, inverse, make_pose, rigid


@dataclass(frozen=True, slots=True)
class DenseTrackingConfig:
    """Settings of dense tracking.

    Attributes:
        voxels: Voxels along each edge of the volume.
        size: Edge of the volume, metres.
        truncation: Distance from a surface beyond which distances are cut off, metres.
        most: Largest weight of a voxel; what is older counts less and less.
        furthest: Metres.
        rounds: Steps for each stride of pixels, from coarse to fine.
        reach: Largest distance of points that belong together, metres.
        least: Share of the pixels that must have a partner; with less track is lost.
    """

    voxels: int = 256
    size: float = 6.0
    truncation: float = 0.1
    most: float = 64.0
    furthest: float = 6.0
    rounds: tuple[tuple[int, int], ...] = ((4, 10), (2, 5), (1, 4))
    reach: float = 0.1
    least: float = 0.2


CONFIG = DenseTrackingConfig()


def best_device() -> str:
    """Return the name of the first graphics processor, or that of the processor."""
    return "cuda:0" if wp.is_cuda_available() else "cpu"


class DenseTracker:
    """Volume of a room and the camera in it. The first camera looks into its middle.

    Attributes:
        pose: (4, 4) camera to the frame of the first one.
        lost: Whether the last image could not be tracked.
        device: Where the kernels run.
    """

    def __init__(self, camera: Camera, config: DenseTrackingConfig = CONFIG, device: str = "") -> None:
        """Begin with an empty volume.

        Args:
            camera: Camera of the images.
            config: Settings.
            device: `cpu` or `cuda:N`; empty for the best.
        """
        self.pose = np.eye(4)
        self.lost = False
        self.device = device or best_device()
        self._camera, self._config = camera, config
        self._intrinsics = wp.vec4(camera.fx, camera.fy, camera.cx, camera.cy)
        half = config.size / 2
        self._corner = wp.vec3(-half, -half, -0.2)
        shape = (camera.height, camera.width)
        self._volume = self._zeros((config.voxels,) * 3, wp.vec2)
        self._vertices, self._model, self._normals = (self._zeros(shape, wp.vec3) for _ in range(3))
        self._sums = self._zeros((29,), float)
        self._empty = True

    def add(self, depth: Depth) -> Pose:
        """Track an image (height, width), metres, 0 = none, and take it into the volume; return the pose.

        Raises:
            InvalidRequest: The image has another size than the camera.
        """
        if depth.shape != (self._camera.height, self._camera.width):
            raise InvalidRequest(f"the depth image of {depth.shape} is not of the camera")
        image = wp.array(np.ascontiguousarray(depth, np.float32), dtype=float, device=self.device)
        # Surface measurement.
        self._launch(kernels.measure, depth.shape, image, self._intrinsics, self._vertices)
        if not self._empty:
            # Surface prediction from the last pose, then the pose of the sensor.
            self._cast()
            found = self._track()
            self.lost = found is None
            if found is None:
                return self.pose
            self.pose = found
        # Update of the reconstruction.
        config = self._config
        where = (self._corner, self._voxel, config.truncation, config.most)
        size = (config.voxels,) * 3
        self._launch(
            kernels.integrate, size, self._volume, *where, image, self._intrinsics, _matrix(inverse(self.pose))
        )
        self._empty = False
        return self.pose

    @property
    def _voxel(self) -> float:
        return self._config.size / self._config.voxels

    def _cast(self) -> None:
        config = self._config
        # Half of the truncation is the longest step that cannot miss a surface.
        where = (self._corner, self._voxel, 0.5 * config.truncation, config.furthest)
        shape = (self._camera.height, self._camera.width)
        target = (self._model, self._normals)
        self._launch(kernels.cast, shape, self._volume, *where, self._intrinsics, _matrix(self.pose), *target)

    def _track(self) -> Pose | None:
        """Return the pose by Gauss-Newton steps from coarse to fine, None if too little fits."""
        pose, pairs, pixels = self.pose, 0.0, 1
        for stride, rounds in self._config.rounds:
            for _ in range(rounds):
                matrix, right, pairs, pixels = self._equations(pose, stride)
                if pairs < self._config.least * pixels or np.linalg.cond(matrix) > 1e8:
                    return None
                step = np.linalg.solve(matrix, right)
                turn = Rotation.from_rotvec(step[3:]).as_matrix()
                pose = rigid(make_pose(turn, step[:3]) @ pose)
        return pose

    def _equations(self, pose: Pose, stride: int) -> tuple[Floats, Floats, float, int]:
        """Return matrix (6, 6) and right side (6,) of a step, the number of pairs, and that of pixels with depth."""
        self._sums.zero_()
        shape = (self._camera.height // stride, self._camera.width // stride)
        seen = (_matrix(pose), _matrix(inverse(self.pose)), self._intrinsics)
        model = (self._model, self._normals)
        self._launch(kernels.equations, shape, self._vertices, stride, *seen, *model, self._config.reach, self._sums)
        sums = self._sums.numpy().astype(np.float64)
        matrix = np.zeros((6, 6))
        matrix[np.triu_indices(6)] = sums[:21]
        matrix += np.triu(matrix, 1).T
        return matrix, sums[21:27], float(sums[28]), shape[0] * shape[1]

    def _zeros(self, shape: tuple[int, ...], kind: Any) -> Any:
        return wp.zeros(shape, dtype=kind, device=self.device)

    def _launch(self, kernel: Any, size: tuple[int, ...], *inputs: Any) -> None:
        wp.launch(kernel, dim=size, inputs=list(inputs), device=self.device)


def _matrix(pose: Pose) -> Any:
    return wp.mat44(*pose.astype(np.float32).ravel().tolist())

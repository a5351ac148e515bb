"""Compiled inner loop of dense alignment: one linearisation of the errors of brightness and depth."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rce.mapping.matching.kernels import compiled

DEGREES_OF_FREEDOM = 5.0  # of Student's t distribution of errors (Kerl, Sturm and Cremers, ICRA 2013, section III-C)
SIZE = 8  # unknowns: translation, rotation, gain, bias
SUMS = 7  # of a linearisation, see `linearise`
FITTING = 4.0  # standard deviations of the noise of depth, within which a depth fits
MAX_DEPTH_ERROR = 0.08  # as a share of the depth; a larger one is another surface, not an error

Floats = NDArray[np.float32]


@compiled(
    "void(float32[:,::1], float32[:,::1], float32[::1], float32[:,::1], float32[:,::1], float64[::1], float64[:,::1], "
    "float64, float64, float64, float64, float64[:,::1], float64[::1], float64[::1])"
)
def linearise(
    points: Floats,
    normals: Floats,
    brightness: Floats,
    image: Floats,
    depth: Floats,
    intrinsics: NDArray[np.float64],
    pose: NDArray[np.float64],
    gain: float,
    bias: float,
    brightness_scale: float,
    depth_scale: float,
    hessian: NDArray[np.float64],
    gradient: NDArray[np.float64],
    sums: NDArray[np.float64],
) -> None:
    """Add up the normal equations of the alignment of a reference with an image, at one pose.

    Errors of brightness are those of Kerl, Sturm and Cremers (Robust Odometry Estimation for RGB-D Cameras, 2013) with
    gain and bias of the exposure as further unknowns; errors of depth are distances from point to plane with projective
    association (Rusinkiewicz and Levoy, Efficient Variants of the ICP Algorithm, 2001). Both kinds are weighted by
    Student's t distribution.

    Args:
        points: (n, 3) points of the reference, its camera frame, metres.
        normals: (n, 3) unit normals there, zeros where unknown.
        brightness: (n,) of the reference at these points, 0 to 255; negative where only the depth counts.
        image: (height, width) brightness of the image.
        depth: (height, width) metres, 0 = none.
        intrinsics: (7,) fx, fy, cx, cy of the image; b0, b1 of the noise of depth: sigma = b0 + b1 depth^2; and the
            pixels by which colours may be off their depths, which makes steep places of the image less certain.
        pose: (4, 4) takes points of the reference to the camera frame of the image.
        gain: Brightness in the image by brightness in the reference.
        bias: Brightness added.
        brightness_scale: Scale of the errors of brightness.
        depth_scale: Scale of the errors of depth, as a multiple of sigma.
        hessian: (8, 8) set to J' W J; order translation, rotation (both of the image's frame, applied on the left),
            gain, bias.
        gradient: (8,) set to J' W e.
        sums: (7,) set to the points inside the image, the number of errors of brightness, their weighted sum of
            squares, the number of errors of depth, their weighted sum of squares, the points whose depth fits, and the
            points with a normal that have a depth in the image.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    height, width = image.shape
    hessian[:] = 0.0
    gradient[:] = 0.0
    sums[:] = 0.0
    j = np.zeros(SIZE)
    nu = DEGREES_OF_FREEDOM
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]
        y = pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]
        z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        if z < 0.1:
            continue
        inverse = 1.0 / z
        u, v = fx * x * inverse + cx, fy * y * inverse + cy
        if not (1.0 <= u < width - 2.0 and 1.0 <= v < height - 2.0):
            continue
        sums[0] += 1.0
        column, row = int(u), int(v)
        a, b = u - column, v - row
        # Depth, at the nearest pixel: interpolation would invent points across edges.
        near_row, near_column = int(v + 0.5), int(u + 0.5)
        measured = float(depth[near_row, near_column])
        fits = True
        if measured > 0.0:
            fits = abs(measured - z) < MAX_DEPTH_ERROR * z
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            known = nx != 0.0 or ny != 0.0 or nz != 0.0
            sums[6] += 1.0 if known else 0.0
            if fits and known:
                tx = pose[0, 0] * nx + pose[0, 1] * ny + pose[0, 2] * nz
                ty = pose[1, 0] * nx + pose[1, 1] * ny + pose[1, 2] * nz
                tz = pose[2, 0] * nx + pose[2, 1] * ny + pose[2, 2] * nz
                qx, qy = (near_column - cx) / fx * measured, (near_row - cy) / fy * measured
                error = tx * (x - qx) + ty * (y - qy) + tz * (z - measured)
                sigma = (intrinsics[4] + intrinsics[5] * z * z) * depth_scale
                ratio = error / sigma
                weight = (nu + 1.0) / (nu + ratio * ratio)
                sums[3] += 1.0
                sums[4] += weight * (ratio * depth_scale) ** 2
                if abs(ratio) * depth_scale < FITTING:
                    sums[5] += 1.0
                factor = weight / (sigma * sigma)
                j[0], j[1], j[2] = tx, ty, tz
                j[3], j[4], j[5] = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
                for k in range(6):
                    fk = factor * j[k]
                    gradient[k] += fk * error
                    for m in range(k, 6):
                        hessian[k, m] += fk * j[m]
        if not fits or brightness[i] < 0.0:
            continue
        i00, i01 = float(image[row, column]), float(image[row, column + 1])
        i10, i11 = float(image[row + 1, column]), float(image[row + 1, column + 1])
        value = (1.0 - b) * ((1.0 - a) * i00 + a * i01) + b * ((1.0 - a) * i10 + a * i11)
        # Central differences of the bilinear image, one pixel to each side.
        left = (1.0 - b) * ((1.0 - a) * image[row, column - 1] + a * i00) + b * (
            (1.0 - a) * image[row + 1, column - 1] + a * i10
        )
        right = (1.0 - b) * ((1.0 - a) * i01 + a * image[row, column + 2]) + b * (
            (1.0 - a) * i11 + a * image[row + 1, column + 2]
        )
        above = (1.0 - b) * ((1.0 - a) * image[row - 1, column] + a * image[row - 1, column + 1]) + b * (
            (1.0 - a) * i00 + a * i01
        )
        below = (1.0 - b) * ((1.0 - a) * i10 + a * i11) + b * (
            (1.0 - a) * image[row + 2, column] + a * image[row + 2, column + 1]
        )
        gx, gy = 0.5 * (right - left) * fx * inverse, 0.5 * (below - above) * fy * inverse
        error = value - gain * brightness[i] - bias
        steep = (0.25 * (right - left) ** 2 + 0.25 * (below - above) ** 2) * intrinsics[6] * intrinsics[6]
        variance = brightness_scale * brightness_scale + steep
        squared = error * error / variance
        weight = (nu + 1.0) / (nu + squared)
        sums[1] += 1.0
        sums[2] += weight * squared * brightness_scale * brightness_scale
        factor = weight / variance
        gz = -(gx * x + gy * y) * inverse
        j[0], j[1], j[2] = gx, gy, gz
        j[3], j[4], j[5] = y * gz - z * gy, z * gx - x * gz, x * gy - y * gx
        j[6], j[7] = -brightness[i], -1.0
        for k in range(SIZE):
            fk = factor * j[k]
            gradient[k] += fk * error
            for m in range(k, SIZE):
                hessian[k, m] += fk * j[m]
    for k in range(SIZE):
        for m in range(k):
            hessian[k, m] = hessian[m, k]


@compiled("void(float32[:,:,::1], float32[:,:,::1])")
def fill_normals(points: Floats, normals: Floats) -> None:
    """Set normals (height, width, 3) of points (height, width, 3), zeros where unknown; they point to the camera.

    The normal is that of the triangles between the neighbours two pixels away, if these lie on the same surface.
    """
    height, width = points.shape[0], points.shape[1]
    normals[:] = 0.0
    for row in range(2, height - 2):
        for column in range(2, width - 2):
            z = points[row, column, 2]
            if z <= 0.0:
                continue
            limit = 0.03 * z
            left, right = points[row, column - 2], points[row, column + 2]
            above, below = points[row - 2, column], points[row + 2, column]
            if (
                abs(left[2] - z) > limit
                or abs(right[2] - z) > limit
                or abs(above[2] - z) > limit
                or abs(below[2] - z) > limit
            ):
                continue
            hx, hy, hz = right[0] - left[0], right[1] - left[1], right[2] - left[2]
            vx, vy, vz = below[0] - above[0], below[1] - above[1], below[2] - above[2]
            nx, ny, nz = vy * hz - vz * hy, vz * hx - vx * hz, vx * hy - vy * hx
            length = math.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0.0:
                normals[row, column, 0] = nx / length
                normals[row, column, 1] = ny / length
                normals[row, column, 2] = nz / length

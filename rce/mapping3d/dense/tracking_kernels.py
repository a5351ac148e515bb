"""Kernels of dense tracking in Warp: one source that runs on processors and on graphics processors.

Newcombe et al., KinectFusion: Real-Time Dense Surface Mapping and Tracking, 2011; the numbers of sections are theirs.

Warp reads annotations as they are, so they are not postponed here, and mypy does not know its language.
"""

from typing import Any

import warp as wp

wp.config.quiet = True

Kernel: Any = wp.kernel
Function: Any = wp.func


@Function
def ray_of(camera: wp.vec4, u: int, v: int) -> wp.vec3:
    """Return the ray of a pixel at depth 1; `camera` is fx, fy, cx, cy."""
    return wp.vec3((float(u) - camera[2]) / camera[0], (float(v) - camera[3]) / camera[1], 1.0)


@Kernel
def measure(
    depth: wp.array2d(dtype=float),
    camera: wp.vec4,
    vertices: wp.array2d(dtype=wp.vec3),
) -> None:
    """Find the points of a depth image, frame of the camera, metres; 0 where there is none (section 3.2)."""
    v, u = wp.tid()
    vertices[v, u] = ray_of(camera, u, v) * depth[v, u]


@Kernel
def integrate(
    volume: wp.array3d(dtype=wp.vec2),
    corner: wp.vec3,
    voxel: float,
    truncation: float,
    most: float,
    depth: wp.array2d(dtype=float),
    camera: wp.vec4,
    to_camera: wp.mat44,
) -> None:
    """Take a depth image into the volume of signed distance and weight (section 3.3)."""
    i, j, k = wp.tid()
    centre = corner + voxel * wp.vec3(float(i) + 0.5, float(j) + 0.5, float(k) + 0.5)
    seen = wp.transform_point(to_camera, centre)
    if seen[2] <= 0.05:
        return
    u = int(wp.floor(camera[0] * seen[0] / seen[2] + camera[2] + 0.5))
    v = int(wp.floor(camera[1] * seen[1] / seen[2] + camera[3] + 0.5))
    if u < 0 or v < 0 or u >= depth.shape[1] or v >= depth.shape[0]:
        return
    measured = depth[v, u]
    if measured <= 0.0:
        return
    # The distance along the ray, from the surface to the voxel.
    away = (measured - seen[2]) * wp.length(ray_of(camera, u, v))
    if away < -truncation:
        return
    old = volume[i, j, k]
    share = wp.min(1.0, away / truncation)
    weight = old[1] + 1.0
    volume[i, j, k] = wp.vec2((old[0] * old[1] + share) / weight, wp.min(weight, most))


@Function
def sample(volume: wp.array3d(dtype=wp.vec2), place: wp.vec3) -> wp.vec2:
    """Return the interpolated distance at a place, in voxels, and whether all eight voxels around it were seen."""
    x, y, z = place[0] - 0.5, place[1] - 0.5, place[2] - 0.5
    i, j, k = int(wp.floor(x)), int(wp.floor(y)), int(wp.floor(z))
    if i < 0 or j < 0 or k < 0 or i + 1 >= volume.shape[0] or j + 1 >= volume.shape[1] or k + 1 >= volume.shape[2]:
        return wp.vec2(1.0, 0.0)
    a, b, c = x - float(i), y - float(j), z - float(k)
    total = float(0.0)
    seen = float(1.0)
    for di in range(2):
        for dj in range(2):
            for dk in range(2):
                each = volume[i + di, j + dj, k + dk]
                if each[1] <= 0.0:
                    seen = 0.0
                share = wp.where(di == 1, a, 1.0 - a) * wp.where(dj == 1, b, 1.0 - b) * wp.where(dk == 1, c, 1.0 - c)
                total += share * each[0]
    return wp.vec2(total, seen)


@Kernel
def cast(
    volume: wp.array3d(dtype=wp.vec2),
    corner: wp.vec3,
    voxel: float,
    step: float,
    furthest: float,
    camera: wp.vec4,
    to_map: wp.mat44,
    vertices: wp.array2d(dtype=wp.vec3),
    normals: wp.array2d(dtype=wp.vec3),
) -> None:
    """Find the surface that each pixel sees, frame of the map; a normal of length 0 where there is none (3.4)."""
    v, u = wp.tid()
    origin = (wp.transform_point(to_map, wp.vec3(0.0, 0.0, 0.0)) - corner) / voxel
    ray = wp.normalize(wp.transform_vector(to_map, ray_of(camera, u, v)))
    normals[v, u] = wp.vec3(0.0, 0.0, 0.0)
    at = float(0.1) / voxel
    before = float(1.0)
    was_seen = float(0.0)
    stride = step / voxel
    while at < furthest / voxel:
        found = sample(volume, origin + ray * at)
        if found[1] > 0.0 and was_seen > 0.0 and before > 0.0 and found[0] <= 0.0:
            # The surface is where the distance is 0 between the last two steps.
            exact = at - stride * found[0] / (found[0] - before)
            place = origin + ray * exact
            dx = sample(volume, place + wp.vec3(1.0, 0.0, 0.0))[0] - sample(volume, place - wp.vec3(1.0, 0.0, 0.0))[0]
            dy = sample(volume, place + wp.vec3(0.0, 1.0, 0.0))[0] - sample(volume, place - wp.vec3(0.0, 1.0, 0.0))[0]
            dz = sample(volume, place + wp.vec3(0.0, 0.0, 1.0))[0] - sample(volume, place - wp.vec3(0.0, 0.0, 1.0))[0]
            vertices[v, u] = corner + voxel * place
            normals[v, u] = wp.normalize(wp.vec3(dx, dy, dz))
            return
        before = found[0]
        was_seen = found[1]
        at += stride


@Kernel
def equations(
    vertices: wp.array2d(dtype=wp.vec3),
    stride: int,
    pose: wp.mat44,
    model_to_camera: wp.mat44,
    camera: wp.vec4,
    model_vertices: wp.array2d(dtype=wp.vec3),
    model_normals: wp.array2d(dtype=wp.vec3),
    reach: float,
    sums: wp.array(dtype=float),
) -> None:
    """Sum the normal equations of the motion that lays points of an image on the planes of the model (section 3.5).

    A point belongs to the pixel of the model that it projects to. `sums` gets the upper triangle (21) of the matrix,
    the right side (6), the sum of squares and the number of pairs.
    """
    row, column = wp.tid()
    v, u = row * stride, column * stride
    own = vertices[v, u]
    if own[2] <= 0.0:
        return
    moved = wp.transform_point(pose, own)
    seen = wp.transform_point(model_to_camera, moved)
    if seen[2] <= 0.05:
        return
    x = int(wp.floor(camera[0] * seen[0] / seen[2] + camera[2] + 0.5))
    y = int(wp.floor(camera[1] * seen[1] / seen[2] + camera[3] + 0.5))
    if x < 0 or y < 0 or x >= model_normals.shape[1] or y >= model_normals.shape[0]:
        return
    normal = model_normals[y, x]
    if wp.length_sq(normal) < 0.5:
        return
    off = model_vertices[y, x] - moved
    if wp.length(off) > reach:
        return
    error = wp.dot(normal, off)
    turn = wp.cross(moved, normal)
    for i in range(6):
        left = wp.where(i < 3, normal[i % 3], turn[i % 3])
        for j in range(i, 6):
            right = wp.where(j < 3, normal[j % 3], turn[j % 3])
            wp.atomic_add(sums, i * (13 - i) // 2 + j - i, left * right)  # by rows of the triangle
        wp.atomic_add(sums, 21 + i, left * error)
    wp.atomic_add(sums, 27, error * error)
    wp.atomic_add(sums, 28, 1.0)

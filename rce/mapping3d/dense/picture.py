"""Picture of a dense map for people: from above and from the side, with the paths of the robots and a scale bar."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.files.picture import MARGIN, PATHS, Image, draw_path, draw_scale_bar
from rce.mapping3d.dense.mesh import Mesh
from rce.mapping3d.dense.rasteriser import draw_triangles
from rce.mapping3d.poses import Pose, make_pose, transform

HEIGHT, WIDEST = 900, 1400  # pixels of each view
FOOTER = 48  # pixels for the scale bar
PAPER = (245, 243, 240)
LIGHT = np.array([0.3, 0.5, 0.81])  # towards the light, level frame
AMBIENT = 0.55
TILT = math.radians(35)  # of the view from the side, below the horizon


Floats = NDArray[np.float64]


def draw(mesh: Mesh, paths: Mapping[int, Sequence[Pose]], level: Pose) -> bytes:
    """Return a PNG of a map, from above on the left, from behind the first camera on the right.

    Surfaces are seen from their free side only, so ceilings and near walls hide nothing.

    Args:
        mesh: The surface, map frame.
        paths: Poses of each robot's camera along its way, camera to map.
        level: Pose that takes points of the map to the level frame.
    """
    points = transform(level, mesh.cloud.points)
    normals = mesh.cloud.normals.astype(np.float64) @ level[:3, :3].T
    light = AMBIENT + (1 - AMBIENT) * np.clip(normals @ LIGHT, 0.0, 1.0)
    colors = np.ascontiguousarray((mesh.cloud.colors[:, ::-1] * light[:, None]).astype(np.float32))
    ways = {robot: np.array([(level @ pose)[:3, 3] for pose in poses]).reshape(-1, 3) for robot, poses in paths.items()}
    # x of the level frame, the first view, is up in the picture.
    above = make_pose([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [0, 0, 0])
    c, s = math.cos(TILT), math.sin(TILT)
    aside = make_pose(np.array([[0, -1, 0], [-s, 0, -c], [c, 0, -s]]), [0, 0, 0])
    views = [_view(points, colors, mesh.triangles, ways, each) for each in (above, aside)]
    done, png = cv2.imencode(".png", np.hstack(views))
    if not done:
        raise RuntimeError("OpenCV cannot encode the picture of the map")
    return png.tobytes()


def _view(
    points: Floats, colors: NDArray[np.float32], triangles: NDArray[np.int32], ways: Mapping[int, Floats], view: Pose
) -> Image:
    """Draw one view; `view` takes points of the level frame to right, down, away."""
    seen, seen_ways = transform(view, points), {robot: transform(view, way) for robot, way in ways.items()}
    low, high = _extent([seen, *seen_ways.values()])
    scale = min(HEIGHT / (high[1] - low[1]), WIDEST / (high[0] - low[0]))
    width, height = (math.ceil(scale * side) for side in (high - low).tolist())
    image = np.full((height, width, 3), PAPER, np.float32)
    corners = (seen - [*low, 0.0]) * [scale, scale, 1.0]
    draw_triangles(image, np.full((height, width), np.inf, np.float32), corners, colors, triangles)
    picture = np.full((HEIGHT + FOOTER + 2 * MARGIN, width + 2 * MARGIN, 3), PAPER, np.uint8)
    inner = picture[MARGIN : MARGIN + height, MARGIN : MARGIN + width]
    inner[:] = np.clip(image, 0, 255).astype(np.uint8)
    for robot, way in seen_ways.items():
        draw_path(picture, (way[:, :2] - low) * scale + MARGIN, PATHS[robot % len(PATHS)])
    draw_scale_bar(picture, scale)
    return picture


def _extent(parts: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest column and row, at least 1 m apart; stray points of a part may be outside."""
    ends = np.zeros((1, 2))
    if any(map(len, parts)):
        ends = np.concatenate([np.quantile(each[:, :2], [0.001, 0.999], axis=0) for each in parts if len(each)])
    low, high = ends.min(axis=0), ends.max(axis=0)
    missing = np.maximum(1.2 - (high - low), 0.2) / 2
    return low - missing, high + missing

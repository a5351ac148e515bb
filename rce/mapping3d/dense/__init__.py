"""Dense maps from key frames with optimised poses: surfaces, clouds, voxels, and the floor plan for navigation.

`dense_map` has the class that others use. Below it:

- `volume`, `kernels`: the truncated signed distance function in hashed blocks of voxels.
- `kept_frames`: the packed images or planes of key frames, which are taken out and put in again when a loop moves them.
- `marching_cubes`, `mesh`: the surface as triangles; `ply`, `octree`: files of it.
- `level`: the direction of gravity and the floor, found in the surface.
- `floor_plan`, `frontiers`: the occupancy grid cut from the volume, and where to look next.
- `tracking`, `tracking_kernels`: the pose of each image against the surface of all before it, on graphics processors.
- `rasteriser`, `picture`: a picture of the map with the paths of the robots.

Otherwise where poses come from is not the subject of this package.
"""

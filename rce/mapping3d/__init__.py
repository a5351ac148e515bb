"""Mapping in three dimensions with a camera that sees colour and depth.

The package needs no ROS; only `offload.client`, `offload.streaming` and `offload.runs` use a network. The ROS 2 nodes
around it are in `containers/nodes/rce_mapping3d`, the command line in `rce.cli`. Code that knows ROS nodes, HTTP or the
command line does not belong here.

Layout, from the types that all share to the mapper built on them:

- `camera`, `frames`, `poses`: the pinhole camera, images with depth, rigid motions.
- `odometry`: the front end, which runs on a robot: the motion of the camera from frame to frame, and key frames.
- `places`: recognising a place that was seen before, and the pose between the two views.
- `graph`: the back end: the pose graph of one robot or of several, loops, saved sessions.
- `dense`: surfaces, clouds and grids from key frames with optimised poses.
- `lidar`: the same for clouds of lidars.
- `offload`: a map in the cloud of robots that track themselves.
- `files`: recordings, trajectories, pictures.
- `evaluation`: errors of trajectories, and a simulated room.

Conventions: metres, radians, seconds. The frame of a camera is the optical one: x to the right, y down, z forward. A
pose is a (4, 4) float64 matrix that takes points from the frame of the camera to that of the map. Pixel (u, v) has its
centre at integer coordinates. Tunable values are fields of frozen dataclasses with one documented default.
"""

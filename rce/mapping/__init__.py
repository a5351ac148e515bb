"""Mapping and localisation with a planar laser: scan matching, mappers, occupancy grids and their files.

The package is pure: it needs neither ROS nor a network, only the extra `mapping` (NumPy, SciPy, Numba, OpenCV,
rosbags). The ROS 2 nodes around it are in `containers/nodes/rce_mapping`, the command line in `rce.cli`, the service in
`rce.mapservice`. Code that knows ROS nodes, HTTP or the command line does not belong here. `robot` is the one
exception: it drives a recording through a mapping node of the platform, by way of `rce.client`.

Layout, from the types that all share to the mappers built on them:

- `geometry`, `scans`, `grid`: poses, one sweep of the laser, occupancy grids.
- `mapper`, `mappers`: the interface of a mapper, and the mappers by name.
- `pairing`, `motion`, `history`, `state`: odometry for each scan, pose prediction, the trajectory, saved state.
- `matching`: finding the pose at which a scan fits a map. It holds the compiled kernels.
- `laser_odometry`: poses from consecutive scans, with or without wheel odometry.
- `pose_graph`: the mapper `graph`, which closes loops, and the mapper of a team of robots.
- `particles`: the mapper `particle`, a Rao-Blackwellized particle filter.
- `localiser`: finding and tracking a robot in a known map.
- `files`: recordings, maps, pictures and saved sessions.
- `evaluation`: a simulated robot, and trials of mappers on recordings with ground truth.

Conventions: metres, radians, seconds; x points forward, y to the left, angles grow counter-clockwise. Tunable values
are fields of frozen dataclasses with one documented default instance for each algorithm; kernels get plain numbers.
"""

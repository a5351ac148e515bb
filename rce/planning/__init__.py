"""Path planning on occupancy grids: costmaps, planners from start to goal, coverage paths, and their files.

The package is pure: it needs neither ROS nor a network, only the extra `mapping` (NumPy, SciPy, Numba, OpenCV). The
ROS 2 node around it is in `containers/nodes/rce_planning`, the command line in `rce.cli`, the HTTP interface in
`rce.mapservice`. Code that knows ROS nodes, HTTP or the command line does not belong here.

- `failures`: why there is no path.
- `footprint`, `costmap`: the robot's outline, and the cost of each cell for it.
- `search`: compiled shortest paths on cells (A*, Dijkstra) and on poses (Hybrid-A*).
- `curves`: the shortest curves of bounded curvature, by Dubins and by Reeds and Shepp.
- `astar`, `hybrid`, `voronoi`: planners from start to goal; `planner` has them by name.
- `smoothing`, `coverage`: smoother paths, and paths that pass over all of the free space.
- `files`: paths as CSV, pictures.

Conventions are those of `rce.mapping`: metres, radians; x points forward, y to the left, angles grow counter-clockwise.
"""

"""Scan matching: finding the pose at which a scan fits a local or a known map.

- `fields`, `ndt`: representations of the walls, a likelihood field and normal distributions.
- `kernels`, `branch_and_bound`: compiled inner loops and the exact search of large windows.
- `scan_matching`, `wide_search`: matching near a prediction, and where the motion is unknown.
- `local_map`, `known_map`: the maps that scans are matched with.
- `agreement`: whether two views of what may be one place contradict each other.

Deciding when a loop is closed belongs to `rce.mapping.pose_graph`.
"""

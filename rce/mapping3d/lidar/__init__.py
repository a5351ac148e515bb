"""Lidars that measure in three dimensions.

- `odometry`: the front end: the pose of each sweep, and key frames made of the sweeps since the one before.
- `registration`: the motion between two clouds, and what it leaves open.
- `scan_context`: which key frames look alike.
- `mapper`: the back end: loops are closed, robots are joined.
- `packing`: clouds as they are sent and kept.

The frame of a lidar is as on its robot: x forward, y to the left, z up. `rce.mapping.clouds` decodes messages.
"""

"""Lidars that measure in three dimensions.

- `clouds`: points and their times out of `sensor_msgs/PointCloud2` of any layout.

The frame of a lidar is as on its robot: x forward, y to the left, z up.
"""

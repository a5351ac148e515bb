"""The ROS 2 face of `rce.mapping`."""

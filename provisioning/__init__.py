"""Setting machines up: type support for ROS 2 interfaces that the wheels lack, and the script `provision`."""

"""Environment endpoint: the process in an environment that speaks ROS 2 for robots and runs the environment's nodes.

All of rclpy is used in one thread (`ros`). How environments are started belongs to `containers`.
"""

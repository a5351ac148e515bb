"""Environment endpoint: the one process of an environment that speaks ROS 2 for its robots, and starts their nodes."""

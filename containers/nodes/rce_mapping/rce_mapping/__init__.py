"""ROS 2 nodes around `rce.mapping`: the nodes `mapper` and `team`.

Topics, services, parameters and transforms belong here, algorithms in `rce.mapping`.
"""

"""ROS 2 nodes around `rce.mapping3d`: the nodes `mapper` and `tracker`.

Topics, services and parameters belong here, algorithms in `rce.mapping3d`. What both packages of nodes need is in
`rce_mapping`, which stands beside this one.
"""

"""Endpoints: the processes at the two ends of every data path, and the data path between them.

`data` holds what all endpoints share: interfaces, routes and links. `robot` serves robots' WebSockets, `environment`
speaks ROS 2 in an environment, and `bridge` connects the ROS 2 of a robot itself. What belongs to the Master, to task
sets or to robots' own programs does not belong here.
"""

"""The ROS graph of an environment: its topics and services."""

from __future__ import annotations

from rclpy.node import Node

from rce.control.calls.watching import RosGraph, RosName


def read_graph(node: Node) -> RosGraph:
    """Return the graph as `node` sees it; called in the ROS thread."""
    topics = [
        RosName(name, types, node.count_publishers(name), node.count_subscribers(name))
        for name, types in node.get_topic_names_and_types()
    ]
    services = [RosName(name, types) for name, types in node.get_service_names_and_types()]
    return RosGraph(sorted(topics, key=_by_name), sorted(services, key=_by_name))


def _by_name(each: RosName) -> str:
    return each.name

"""The ROS graph of an environment: its topics, services, actions and nodes."""

from __future__ import annotations

from rclpy.action.graph import get_action_names_and_types
from rclpy.node import Node, NodeNameNonExistentError
from rclpy.topic_endpoint_info import TopicEndpointInfo

from endpoints.environment.prepared_node import NODE as PREPARED
from endpoints.environment.ros_actions import part_of
from rce.control.calls.watching import RosAction, RosGraph, RosName, RosNode


def read_graph(node: Node) -> RosGraph:
    """Return the graph as `node` sees it, without the prepared node."""
    topics = [
        RosName(name, types, node.count_publishers(name), node.count_subscribers(name))
        for name, types in node.get_topic_names_and_types()
    ]
    services = [
        RosName(name, types)
        for name, types in node.get_service_names_and_types()
        if not name.startswith(f"/{PREPARED}/")
    ]
    actions = [_action(node, name, types) for name, types in get_action_names_and_types(node)]
    nodes = [_node(node, *each) for each in set(node.get_node_names_and_namespaces()) if each[0] != PREPARED]
    return RosGraph(*(sorted(each, key=_by_name) for each in (topics, services, actions, nodes)))  # type: ignore[arg-type]


def _node(node: Node, name: str, namespace: str) -> RosNode:
    """Return a node with what it publishes, subscribes to and serves; it may have gone meanwhile."""
    full = f"{namespace.rstrip('/')}/{name}"
    try:
        published = node.get_publisher_names_and_types_by_node(name, namespace)
        subscribed = node.get_subscriber_names_and_types_by_node(name, namespace)
        served = node.get_service_names_and_types_by_node(name, namespace)
    except NodeNameNonExistentError:
        return RosNode(full)
    return RosNode(full, *(sorted(each for each, _ in found) for found in (published, subscribed, served)))


def _action(node: Node, name: str, types: list[str]) -> RosAction:
    """Return an action with its servers, which publish feedback, and its clients, which subscribe to it."""
    feedback = part_of(name, "feedback")
    servers = {_full_name(info) for info in node.get_publishers_info_by_topic(feedback)}
    clients = {_full_name(info) for info in node.get_subscriptions_info_by_topic(feedback)}
    return RosAction(name, types, sorted(servers), sorted(clients))


def _full_name(info: TopicEndpointInfo) -> str:
    return f"{info.node_namespace.rstrip('/')}/{info.node_name}"


def _by_name(each: RosName | RosAction | RosNode) -> str:
    return each.name

"""The ROS graph as the endpoint sees it."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

import rclpy
from std_msgs.msg import String
from std_srvs.srv import SetBool

from endpoints.environment.prepared_node import NODE
from endpoints.environment.ros_graph import read_graph
from rce.control.calls.watching import RosName
from tests.support.endpoints.ros_world import RosWorld


async def test_topics_and_services_of_nodes_are_sorted_and_counted(world: RosWorld) -> None:
    node = world.other
    for _ in range(2):
        node.create_subscription(String, "/read/zebra", print, 10)
    node.create_publisher(String, "/read/zebra", 10)
    node.create_publisher(String, "/read/ape", 10)
    node.create_service(SetBool, "/read/flip", lambda request, response: response)
    topics = [
        RosName("/read/ape", ["std_msgs/msg/String"], 1, 0),
        RosName("/read/zebra", ["std_msgs/msg/String"], 1, 2),
    ]
    services = [RosName("/read/flip", ["std_srvs/srv/SetBool"])]

    def complete() -> bool:
        graph = read_graph(world.ros.node)
        return [_ours(graph.topics), _ours(graph.services)] == [topics, services]

    await world.until(complete)


async def test_nodes_have_their_topics_and_services(world: RosWorld) -> None:
    node = world.other
    node.create_subscription(String, "/nodes/in", print, 10)
    node.create_publisher(String, "/nodes/out", 10)
    node.create_service(SetBool, "/nodes/flip", lambda request, response: response)

    def complete() -> bool:
        found = [each for each in read_graph(world.ros.node).nodes if "/nodes/out" in each.publishes]
        return any("/nodes/in" in each.subscribes and "/nodes/flip" in each.serves for each in found)

    await world.until(complete)


async def test_prepared_node_is_not_shown(world: RosWorld) -> None:
    prepared = rclpy.create_node(NODE, context=world.other.context)
    shown = rclpy.create_node("shown", context=world.other.context)

    def complete() -> bool:
        graph = read_graph(world.ros.node)
        names = {each.name for each in (*graph.nodes, *graph.services)}
        return {"/shown", "/shown/get_parameters"} <= names and not any(name.startswith(f"/{NODE}") for name in names)

    await world.until(lambda: NODE in world.ros.node.get_node_names())
    await world.until(complete)
    prepared.destroy_node()
    shown.destroy_node()


def _ours(names: list[RosName]) -> list[RosName]:
    return [each for each in names if each.name.startswith("/read/")]

"""Interfaces of robots beside what the environment has."""

from __future__ import annotations

import pytest

from endpoints.gateways.robots import find, with_robots
from rce.control.calls.robots import RobotInterfaceName
from rce.control.calls.watching import RosAction, RosGraph, RosName, RosNode

INTERFACES = [
    RobotInterfaceName("r2", "pose", "SubscriberConverter", "geometry_msgs/Pose2D"),
    RobotInterfaceName("r2", "cmd", "PublisherForwarder", "std_msgs/String"),
    RobotInterfaceName("r2", "stop", "ServiceClientConverter", "std_srvs/Trigger"),
    RobotInterfaceName("r2", "ask", "ServiceProviderConverter", "std_srvs/Trigger"),
    RobotInterfaceName("r2", "drive", "ActionClientConverter", "test_msgs/Fibonacci"),
]


def test_robot_is_a_node_with_topics_services_and_actions() -> None:
    graph = with_robots(RosGraph([RosName("/z", ["std_msgs/msg/String"], 1, 0)], []), INTERFACES)
    assert graph.topics == [
        RosName("/r2/cmd", ["std_msgs/msg/String"], 0, 1),
        RosName("/r2/pose", ["geometry_msgs/msg/Pose2D"], 1, 0),
        RosName("/z", ["std_msgs/msg/String"], 1, 0),
    ]
    assert graph.services == [RosName("/r2/stop", ["std_srvs/srv/Trigger"])]
    assert graph.actions == [RosAction("/r2/drive", ["test_msgs/action/Fibonacci"], servers=["/r2"])]
    assert graph.nodes == [RosNode("/r2", ["/r2/pose"], ["/r2/cmd"], ["/r2/stop"])]


def test_name_that_the_environment_has_is_the_environments() -> None:
    graph = RosGraph([RosName("/r2/pose", ["std_msgs/msg/String"], 0, 1)], [], nodes=[RosNode("/r2")])
    shown = with_robots(graph, INTERFACES[:1])
    assert shown == graph


@pytest.mark.parametrize(
    ("address", "kind", "found"),
    [
        ("/r2/pose", "SubscriberInterface", "r2/pose"),
        ("/r2/pose", "PublisherInterface", ""),
        ("/r2/cmd", "PublisherInterface", "r2/cmd"),
        ("/r2/stop", "ServiceClientInterface", "r2/stop"),
        ("/r2/drive", "ActionClientInterface", "r2/drive"),
        ("/r2", "SubscriberInterface", ""),
        ("/r3/pose", "SubscriberInterface", ""),
    ],
)
def test_interface_is_found_by_its_name_and_direction(address: str, kind: str, found: str) -> None:
    assert find(INTERFACES, address, kind) == found

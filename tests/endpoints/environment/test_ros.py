"""The ROS node of an endpoint, with real ROS 2."""

from __future__ import annotations

import asyncio
import gc
import os

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from std_msgs.msg import String
from twisted.logger import LogEvent

from endpoints.environment.ros import Ros
from tests.support.endpoints.ros_world import LIMIT, NODE, RosWorld


@pytest.fixture
def ros(world: RosWorld) -> Ros:
    return world.ros


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


async def test_entities_that_are_gone_leave_nothing_in_the_group_of_the_node(ros: Ros) -> None:
    before = len(ros.node.default_callback_group.entities)
    ros.node.destroy_publisher(ros.node.create_publisher(String, "/gone", 1))
    ros.node.destroy_subscription(ros.node.create_subscription(String, "/gone", print, 1))
    gc.collect()
    assert len(ros.node.default_callback_group.entities) == before


async def test_action_is_retried_until_it_does_not_ask_again(ros: Ros) -> None:
    turns, done = 0, asyncio.Event()

    def check() -> None:
        nonlocal turns
        turns += 1
        if turns < 5:
            ros.retry(check)
            ros.retry(check)
        else:
            done.set()

    check()
    await asyncio.wait_for(done.wait(), LIMIT)
    assert turns == 5


async def test_defect_in_one_action_does_not_stop_others(ros: Ros, failures: list[LogEvent]) -> None:
    done = asyncio.Event()

    def fail() -> None:
        raise ZeroDivisionError

    ros.listen(fail).again()
    ros.retry(fail)
    ros.retry(done.set)
    await asyncio.wait_for(done.wait(), LIMIT)
    assert len(failures) == 2
    failures.clear()


async def test_publishers_of_the_process_are_known_by_prefix(ros: Ros) -> None:
    infos = ros.node.get_publishers_info_by_topic("/parameter_events")
    own = {info.node_name for info in infos if bytes(info.endpoint_gid[:12]) == ros.prefix}
    assert own == {NODE}


async def test_close_ends_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    own = Ros("short_lived")
    subscription = own.node.create_subscription(String, "/left", print, 1)
    before = open_files()
    own.listen(print, subscription.handle)
    assert open_files() == before + 1
    own.close()
    assert open_files() <= before
    assert not own.node.context.ok()


async def test_error_of_ros_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "nonsense")
    with pytest.raises(_rclpy.RCLError, match="ROS_DOMAIN_ID"):
        Ros("refused")

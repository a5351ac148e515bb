"""The node of the first example."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import String

from tests.support.domains import domain
from tests.support.paths import ROOT
from tests.support.spin import spin_until

NODE = ROOT / "containers" / "nodes" / "rce_demo" / "echo.py"


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_what_is_said_is_heard_until_a_signal(start_ros: Callable[..., None], stop: signal.Signals) -> None:
    start_ros()
    robot, heard = rclpy.create_node("robot"), list[Any]()
    robot.create_subscription(String, "/heard", heard.append, 10)
    say = robot.create_publisher(String, "/say", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(robot)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain("nodes"))}
    program = subprocess.Popen([sys.executable, NODE], env=environment, stderr=subprocess.PIPE, text=True)
    try:
        spin_until(executor, lambda: say.get_subscription_count() == 1 and bool(robot.count_publishers("/heard")))
        while not heard:  # the node may not have discovered the subscription yet
            say.publish(String(data="hello cloud"))
            executor.spin_once(timeout_sec=0.1)
        assert heard[0].data == "hello cloud"
        program.send_signal(stop)
        _, errors = program.communicate(timeout=60)
        assert (program.returncode, errors) == (0, "")
    finally:
        program.kill()
        program.communicate()
        executor.shutdown()
        robot.destroy_node()

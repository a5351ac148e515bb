"""Common base of the benchmark's nodes."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from tests.support.domains import domain

Load = Callable[[str, str], ModuleType]


@pytest.fixture
def arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arguments of the program, some of them of ROS."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain("nodes")))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr("sys.argv", ["node", "one", "--ros-args", "-r", "__ns:=/bench", "--", "two"])


def test_node_has_neither_parameter_services_nor_log_topic(bench: Any, load: Load) -> None:
    node = load("rce_bench", "lean").LeanNode("lean")
    assert not [each.srv_name for each in node.services if "param" in each.srv_name]
    assert "/rosout" not in [each.topic_name for each in node.publishers]
    node.destroy_node()


@pytest.mark.usefixtures("arguments")
def test_node_gets_the_arguments_that_are_not_of_ros(load: Load) -> None:
    got: list[list[str]] = []

    def make(words: list[str]) -> Any:
        got.append(words)
        node = rclpy.create_node("lean")
        assert node.get_namespace() == "/bench"
        node.create_timer(0.01, rclpy.shutdown)  # as the signal handler does
        return node

    assert load("rce_bench", "lean").run(make) == 0
    assert got == [["one", "two"]]
    assert not rclpy.ok()


@pytest.mark.usefixtures("arguments")
def test_interrupt_is_a_normal_end_and_an_error_is_not(load: Load) -> None:
    def fail(error: BaseException) -> Callable[[list[str]], Any]:
        def make(words: list[str]) -> Any:
            raise error

        return make

    run = load("rce_bench", "lean").run
    assert run(fail(KeyboardInterrupt())) == 0
    with pytest.raises(ValueError, match="unusable"):
        run(fail(ValueError("unusable")))
    assert not rclpy.ok()

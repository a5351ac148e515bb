"""Start and end of the nodes' programs."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from rce_mapping import main as module

from tests.support.domains import domain


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], Any]], int]:
    """`run(make)` runs the main function with a node that `make` returns."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain("nodes")))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr("sys.argv", ["mapper"])

    def run(make: Callable[[], Any]) -> int:
        found = SimpleNamespace(MapperNode=make)
        monkeypatch.setattr(module, "importlib", SimpleNamespace(import_module=lambda name: found))
        status: int = module.main("rce_mapping.node", "MapperNode")
        assert not rclpy.ok()
        return status

    return run


def test_interrupt_is_a_normal_end(run: Callable[..., int]) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    assert run(interrupted) == 0


def test_consequence_of_the_shutdown_is_a_normal_end(run: Callable[..., int]) -> None:
    def shut_down() -> None:
        rclpy.shutdown()  # as the signal handler does
        raise RuntimeError("the context is invalid")

    assert run(shut_down) == 0


def test_shutdown_while_the_node_spins_is_a_normal_end(run: Callable[..., int]) -> None:
    def node() -> Any:
        made = rclpy.create_node("ending")
        made.create_timer(0.01, rclpy.shutdown)
        return made

    assert run(node) == 0


def test_error_of_the_node_is_not_hidden(run: Callable[..., int]) -> None:
    def broken() -> None:
        raise ValueError("a parameter is wrong")

    with pytest.raises(ValueError, match="a parameter is wrong"):
        run(broken)
    assert not rclpy.ok()

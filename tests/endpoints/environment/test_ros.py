"""The ROS thread: work that is passed to it, and results that it passes back."""

from __future__ import annotations

import asyncio
import gc
import threading
from functools import partial
from typing import Any

import pytest
from twisted.logger import LogEvent

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from std_msgs.msg import String

from endpoints.environment.ros import RosThread
from tests.support.endpoints.ros_world import LIMIT, NODE, RosWorld


class Waitable:
    """Waitable without entities, which records how it is used."""

    subscriptions = clients = services = events = 0

    def __init__(self) -> None:
        self.taken = self.destroyed = 0

    def add(self, wait_set: _rclpy.WaitSet) -> None: ...

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        self.taken += 1

    def destroy(self) -> None:
        self.destroyed += 1


@pytest.fixture
def ros(world: RosWorld) -> RosThread:
    return world.ros


async def test_work_runs_in_thread_and_its_result_comes_back(ros: RosThread) -> None:
    assert await ros.run(lambda: threading.current_thread().name) == "ros"
    assert await ros.run(lambda: ros.node.get_name()) == NODE


async def test_error_of_work_is_raised_in_caller(ros: RosThread) -> None:
    def fail() -> None:
        raise ZeroDivisionError("in the thread")

    with pytest.raises(ZeroDivisionError, match="in the thread"):
        await ros.run(fail)


async def test_entities_that_are_gone_leave_nothing_in_the_group_of_the_node(ros: RosThread) -> None:
    def come_and_go() -> None:
        ros.node.destroy_publisher(ros.node.create_publisher(String, "/gone", 1))
        ros.node.destroy_subscription(ros.node.create_subscription(String, "/gone", print, 1))

    before = await ros.run(lambda: len(ros.node.default_callback_group.entities))
    await ros.run(come_and_go)
    gc.collect()
    assert await ros.run(lambda: len(ros.node.default_callback_group.entities)) == before


async def test_work_and_results_keep_their_order(ros: RosThread) -> None:
    order: list[int] = []
    results: list[int] = []

    def work(number: int) -> None:
        order.append(number)
        ros.deliver(lambda: results.append(number))

    for number in range(1000):
        ros.post(partial(work, number))
    await ros.run(lambda: None)
    assert order == results == list(range(1000))


async def test_result_for_cancelled_caller_is_left_out(ros: RosThread, failures: list[LogEvent]) -> None:
    release = threading.Event()
    caller = asyncio.create_task(ros.run(release.wait))
    await asyncio.sleep(0)
    caller.cancel()
    await asyncio.wait([caller])
    release.set()
    assert await ros.run(lambda: "next") == "next"
    assert failures == []


async def test_defect_in_one_action_does_not_stop_others(ros: RosThread, failures: list[LogEvent]) -> None:
    def fail() -> None:
        raise ZeroDivisionError

    ros.post(fail)
    ros.deliver(fail)
    assert await ros.run(lambda: "next") == "next"
    assert len(failures) == 2
    failures.clear()


async def test_action_is_retried_until_it_does_not_ask_again(ros: RosThread) -> None:
    loop = asyncio.get_running_loop()
    turns, done = 0, loop.create_future()

    def check() -> None:
        nonlocal turns
        turns += 1
        if turns < 5:
            ros.retry(check)
        else:
            ros.deliver(lambda: done.set_result(None))

    ros.post(check)
    await asyncio.wait_for(done, LIMIT)
    await ros.run(lambda: None)
    assert turns == 5


async def test_later_action_runs_in_thread_after_its_time(ros: RosThread) -> None:
    loop = asyncio.get_running_loop()
    done: asyncio.Future[Any] = loop.create_future()

    def act() -> None:
        name = threading.current_thread().name
        ros.deliver(lambda: done.set_result(name))

    began = loop.time()
    ros.post(lambda: ros.call_later(0.05, act))
    assert await asyncio.wait_for(done, LIMIT) == "ros"
    assert loop.time() - began >= 0.049


async def test_removed_waitable_is_destroyed_and_not_used_again(ros: RosThread) -> None:
    waitable = Waitable()
    await ros.run(lambda: ros.add_waitable(waitable))
    await ros.run(lambda: None)
    await ros.run(lambda: ros.remove_waitable(waitable))
    taken = waitable.taken
    assert (taken > 0, waitable.destroyed) == (True, 1)
    for _ in range(3):
        await ros.run(lambda: None)
    assert waitable.taken == taken


async def test_publishers_of_the_thread_are_known_by_prefix(ros: RosThread) -> None:
    infos = await ros.run(lambda: ros.node.get_publishers_info_by_topic("/parameter_events"))
    own = {info.node_name for info in infos if bytes(info.endpoint_gid[:12]) == ros.prefix}
    assert own == {NODE}


async def test_stop_destroys_what_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    own = RosThread(asyncio.get_running_loop(), "short_lived")
    await own.start()
    waitable = Waitable()
    await own.run(lambda: own.add_waitable(waitable))
    await own.stop()
    assert waitable.destroyed == 1
    assert not own._thread.is_alive()


async def test_start_fails_with_error_of_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "nonsense")
    with pytest.raises(_rclpy.RCLError, match="ROS_DOMAIN_ID"):
        await RosThread(asyncio.get_running_loop(), "refused").start()

"""The thread that owns rclpy, from birth to death.

Everything of rclpy happens in this thread: entities are made, used and destroyed there (other threads that do so crash
it sooner or later). In it runs a loop of our own over one wait set that is kept: rclpy's executors build a new one, and
a task for each callback, at every wake, which costs 0.2 ms of each round trip. Work comes in through `post` and `run`;
what is taken from ROS goes out to the asyncio loop through `deliver`, which wakes that loop once for many messages.
"""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from twisted.logger import Logger

NODE = "_rce_endpoint"  # a leading underscore hides it from lists of nodes
RETRY = 0.005  # seconds between looks at what no event of ROS announces
NANO = 1_000_000_000

log = Logger()
T = TypeVar("T")
Action = Callable[[], None]


class Waited(Protocol):
    """What the thread waits for: handles of ROS entities. All methods run in the thread."""

    subscriptions: int
    clients: int
    services: int
    events: int

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Put the handles into the wait set, or none of them for this time."""

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Take what is ready."""

    def destroy(self) -> None:
        """Destroy the handles."""


class RosThread:
    """One context, one node, one thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop, name: str = NODE) -> None:
        self.loop = loop
        self._name = name
        self.node: Node
        self.prefix: bytes  # what the gids of all our own publishers begin with
        self._context = Context()
        self._guard: _rclpy.GuardCondition
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)
        self._started: asyncio.Future[None] = loop.create_future()
        self._posted: deque[Action] = deque()
        self._delivered: deque[Action] = deque()
        self._woken = False  # the guard condition is triggered already
        self._delivering = False  # the loop is about to look at _delivered
        self._waited: list[Waited] = []
        self._again: dict[Action, None] = {}
        self._ending = False

    async def start(self) -> None:
        """Raises what rclpy raises when it cannot join its ROS domain."""
        self._thread.start()
        await self._started

    async def stop(self) -> None:
        self.post(self._end)
        await asyncio.to_thread(self._thread.join)

    # from any thread

    def post(self, action: Action) -> None:
        """Run `action` in the thread."""
        self._posted.append(action)
        if not self._woken:
            self._woken = True
            self._guard.trigger_guard_condition()

    async def run(self, action: Callable[[], T]) -> T:
        """Run `action` in the thread; returns or raises what it does."""
        done: asyncio.Future[T] = self.loop.create_future()

        def act() -> None:
            try:
                result = action()
            except Exception as error:  # noqa: BLE001  # it is raised in the caller
                self.deliver(lambda error=error: None if done.done() else done.set_exception(error))  # type: ignore[misc]
            else:
                self.deliver(lambda: None if done.done() else done.set_result(result))

        self.post(act)
        return await done

    # from this thread

    def deliver(self, action: Action) -> None:
        """Run `action` in the asyncio loop, after those delivered before."""
        self._delivered.append(action)
        if not self._delivering:
            self._delivering = True
            self.loop.call_soon_threadsafe(self._drain)

    def watch(self, waited: Waited) -> None:
        self._waited = [*self._waited, waited]

    def unwatch(self, waited: Waited) -> None:
        self._waited = [other for other in self._waited if other is not waited]
        waited.destroy()

    def later(self, seconds: float, action: Action) -> None:
        """Run `action` in the thread after that time."""

        def wait() -> None:
            self.loop.call_later(seconds, self.post, action)

        self.deliver(wait)

    def again(self, action: Action) -> None:
        """Run `action` once more in RETRY seconds: for conditions that ROS does not announce."""
        self._again[action] = None

    # the loop's end

    def _drain(self) -> None:
        self._delivering = False
        for _ in range(len(self._delivered)):
            _attempt(self._delivered.popleft())

    # the thread

    def _run(self) -> None:
        try:
            self._begin()
        except Exception as error:  # noqa: BLE001  # it is raised in `start`
            self.loop.call_soon_threadsafe(self._started.set_exception, error)
            return
        self.loop.call_soon_threadsafe(self._started.set_result, None)
        while not self._ending:
            self._spin()
        for waited in self._waited:
            waited.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _begin(self) -> None:
        rclpy.init(context=self._context, args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(
            self._name,
            context=self._context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        assert self._context.handle is not None  # since init
        self._handle = self._context.handle
        self._guard = _rclpy.GuardCondition(self._handle)
        own = [
            info for info in self.node.get_publishers_info_by_topic("/parameter_events") if info.node_name == self._name
        ]
        self.prefix = bytes(own[0].endpoint_gid[:12])

    def _spin(self) -> None:
        waited = self._waited
        wait_set = _rclpy.WaitSet(
            sum(each.subscriptions for each in waited),
            1,
            0,
            sum(each.clients for each in waited),
            sum(each.services for each in waited),
            sum(each.events for each in waited),
            self._handle,
        )
        while self._waited is waited and not self._ending:
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._guard)
            for each in waited:
                each.add(wait_set)
            wait_set.wait(int(RETRY * NANO) if self._again else -1)
            self._work()
            for each in waited:
                if self._waited is not waited:
                    break
                each.take(wait_set)

    def _work(self) -> None:
        self._woken = False
        for action in list(self._again):
            del self._again[action]
            _attempt(action)
        for _ in range(len(self._posted)):
            _attempt(self._posted.popleft())

    def _end(self) -> None:
        self._ending = True


def _attempt(action: Action) -> None:
    try:
        action()
    except Exception:  # noqa: BLE001  # the thread, or the loop's other messages, must go on
        log.failure("a defect beside ROS")

"""The ROS thread, which owns rclpy.

All rclpy entities are created, used and destroyed in this thread; use from other threads crashes rclpy sooner or later.
The thread runs a loop over one wait set that it keeps. rclpy's executors build a new wait set and a task for each
callback at every wake-up, which costs 0.2 ms of each round trip. Other threads submit work by `post` and `run`. The
thread passes results to the asyncio loop by `deliver`, which wakes that loop once for many of them.
"""

from __future__ import annotations

import asyncio
import threading
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol, TypeVar

import rclpy
from rclpy.callback_groups import CallbackGroup, MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from twisted.logger import Logger

NODE = "_rce_endpoint"  # a leading underscore hides it from lists of nodes
RETRY_INTERVAL = 0.005  # seconds between checks of conditions for which ROS has no event
NANO = 1_000_000_000

log = Logger()
T = TypeVar("T")
Action = Callable[[], None]


class Waitable(Protocol):
    """ROS entities on which the thread waits, with the number of their handles. All methods run in the thread."""

    subscriptions: int
    clients: int
    services: int
    events: int

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the handles to the wait set, or none of them this time."""

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Process what is ready in the wait set."""

    def destroy(self) -> None:
        """Destroy the handles."""


class _Group(MutuallyExclusiveCallbackGroup):
    """Forgets entities that are gone; rclpy's groups keep a weak reference to each for ever."""

    def add_entity(self, entity: Any) -> None:  # rclpy defines their type for type checkers only
        self.entities.add(weakref.ref(entity, self.entities.discard))


class _Node(Node):
    """Node whose entities come and go with the interfaces of robots."""

    def __init__(self, name: str, context: Context) -> None:
        self._group = _Group()
        super().__init__(
            name, context=context, use_global_arguments=False, enable_rosout=False, start_parameter_services=False
        )

    @property
    def default_callback_group(self) -> CallbackGroup:
        return self._group


class RosThread:
    """Thread with one rclpy context and one node.

    Attributes:
        loop: The asyncio loop that gets the results.
        node: The node, once started.
        prefix: First 12 bytes of the gids of all publishers of this process.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, name: str = NODE) -> None:
        self.loop = loop
        self._name = name
        self.node: Node
        self.prefix: bytes
        self._context = Context()
        self._guard: _rclpy.GuardCondition
        self._thread = threading.Thread(target=self._run, name="ros", daemon=True)
        self._started: asyncio.Future[None] = loop.create_future()
        self._posted: deque[Action] = deque()
        self._delivered: deque[Action] = deque()
        self._woken = False  # the guard condition has been triggered
        self._delivering = False  # the loop is about to process _delivered
        self._waitables: list[Waitable] = []
        self._retries: dict[Action, None] = {}
        self._stopping = False

    async def start(self) -> None:
        """Start the thread; raise the error of rclpy if it cannot join its ROS domain."""
        self._thread.start()
        await self._started

    async def stop(self) -> None:
        """Destroy all entities and end the thread."""
        self.post(self._stop)
        await asyncio.to_thread(self._thread.join)

    # from any thread

    def post(self, action: Action) -> None:
        """Run `action` in the thread."""
        self._posted.append(action)
        if not self._woken:
            self._woken = True
            self._guard.trigger_guard_condition()

    async def run(self, action: Callable[[], T]) -> T:
        """Run `action` in the thread; return its result or raise its error."""
        done: asyncio.Future[T] = self.loop.create_future()

        def act() -> None:
            try:
                result = action()
            except Exception as error:  # noqa: BLE001  # it is raised in the caller
                failure = error  # `error` is unbound after this block
                self.deliver(lambda: None if done.done() else done.set_exception(failure))
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

    def add_waitable(self, waitable: Waitable) -> None:
        """Wait for the entities of a waitable from now on."""
        self._waitables = [*self._waitables, waitable]

    def remove_waitable(self, waitable: Waitable) -> None:
        """Stop waiting for the entities of a waitable, and destroy them."""
        self._waitables = [other for other in self._waitables if other is not waitable]
        waitable.destroy()

    def call_later(self, seconds: float, action: Action) -> None:
        """Run `action` in the thread after `seconds`."""

        def wait() -> None:
            self.loop.call_later(seconds, self.post, action)

        self.deliver(wait)

    def retry(self, action: Action) -> None:
        """Run `action` after RETRY_INTERVAL seconds, to check a condition for which ROS has no event."""
        self._retries[action] = None

    # in the asyncio loop

    def _drain(self) -> None:
        self._delivering = False
        for _ in range(len(self._delivered)):
            _attempt(self._delivered.popleft())

    # in this thread

    def _run(self) -> None:
        try:
            self._initialize()
        except Exception as error:  # noqa: BLE001  # it is raised in `start`
            self.loop.call_soon_threadsafe(self._started.set_exception, error)
            return
        self.loop.call_soon_threadsafe(self._started.set_result, None)
        while not self._stopping:
            self._spin()
        for waitable in self._waitables:
            waitable.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _initialize(self) -> None:
        # Its messages are in the log of the endpoint; a file of its own would be in the user's home.
        args = ["--ros-args", "--disable-external-lib-logs"]
        rclpy.init(context=self._context, args=args, signal_handler_options=SignalHandlerOptions.NO)
        self.node = _Node(self._name, self._context)
        assert self._context.handle is not None  # since init
        self._handle = self._context.handle
        self._guard = _rclpy.GuardCondition(self._handle)
        own = [
            info for info in self.node.get_publishers_info_by_topic("/parameter_events") if info.node_name == self._name
        ]
        self.prefix = bytes(own[0].endpoint_gid[:12])

    def _spin(self) -> None:
        waitables = self._waitables
        wait_set = _rclpy.WaitSet(
            sum(each.subscriptions for each in waitables),
            1,
            0,
            sum(each.clients for each in waitables),
            sum(each.services for each in waitables),
            sum(each.events for each in waitables),
            self._handle,
        )
        while self._waitables is waitables and not self._stopping:
            wait_set.clear_entities()
            wait_set.add_guard_condition(self._guard)
            for each in waitables:
                each.add(wait_set)
            wait_set.wait(int(RETRY_INTERVAL * NANO) if self._retries else -1)
            self._run_posted()
            for each in waitables:
                if self._waitables is not waitables:
                    break
                each.take(wait_set)

    def _run_posted(self) -> None:
        self._woken = False
        for action in list(self._retries):
            del self._retries[action]
            _attempt(action)
        for _ in range(len(self._posted)):
            _attempt(self._posted.popleft())

    def _stop(self) -> None:
        self._stopping = True


def _attempt(action: Action) -> None:
    try:
        action()
    except Exception:  # noqa: BLE001  # one failing action must not stop the others
        log.failure("defect in an action of the ROS thread")

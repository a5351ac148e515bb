"""Blocking interfaces, which `BlockingRobot` and `BlockingEnvironment` make."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from rce.client.actions import ActionClient, ActionServer, Goal, Handler, ServerGoal
from rce.client.interface import CONNECT_TIMEOUT, Interface
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.threads import Blocking, BlockingStream, LoopThread, blocking
from rce.client.topics import Publisher, Subscriber

I = TypeVar("I", bound=Interface)  # noqa: E741


class BlockingInterface(Blocking[I]):
    """Common base of the blocking interfaces; see `Interface`."""

    @property
    def connected(self) -> bool:
        """True while the robot is online and the interface has a peer that is online too."""
        return self.inner.connected

    @property
    def tag(self) -> str:
        """Name of the interface."""
        return self.inner.tag

    def wait_connected(self, timeout: float = 10.0) -> None:
        """Wait until the interface has a peer.

        Args:
            timeout: Seconds to wait.

        Raises:
            NotConnected: There was no peer for `timeout` seconds.
            RceError: The interface or the robot was closed, or the platform refused the robot.
        """
        self._thread.wait(self.inner.wait_connected(timeout))

    def close(self) -> None:
        """Remove the interface and its connections from the platform.

        Raises:
            TimedOut: The platform did not answer within the robot's `timeout`.
            RceError: Any other error of the platform, for example `NotFound` if the interface was removed already.
        """
        self._thread.wait(self.inner.close())


class BlockingPublisher(BlockingInterface[Publisher]):
    """Blocking `Publisher`."""

    publish = blocking(Publisher.publish)
    """Send a message, after waiting for a peer and for room in the send queue; see `Publisher.publish`."""

    def offer(self, value: Any, keep: int = 1) -> bool:
        """Send a message without waiting; see `Publisher.offer`."""
        return self._thread.call(lambda: self.inner.offer(value, keep))


class BlockingSubscriber(BlockingInterface[Subscriber]):
    """Blocking `Subscriber`: iterate over it, or `get` the next message. Several threads may read it."""

    get = blocking(Subscriber.get)
    """Return the next message; see `Subscriber.get`."""

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped because too many were unread."""
        return self.inner.dropped

    def __iter__(self) -> Iterator[Any]:
        return iter(BlockingStream(self._thread, self.inner.stream))


class BlockingServiceClient(BlockingInterface[ServiceClient]):
    """Blocking `ServiceClient`."""

    call = blocking(ServiceClient.call)
    """Call the service and return its response; see `ServiceClient.call`."""


class BlockingServiceProvider(BlockingInterface[ServiceProvider]):
    """Blocking `ServiceProvider`."""


class BlockingGoal(Blocking[Goal]):
    """Blocking `Goal`: iterate over it to get its feedback."""

    result = blocking(Goal.result)
    """Return the result, waiting until the goal ends; see `Goal.result`."""
    cancel = blocking(Goal.cancel)
    """Ask the action server to cancel the goal; see `Goal.cancel`."""

    @property
    def id(self) -> str:
        """UUID of the goal, 32 hex digits."""
        return self.inner.id

    def __iter__(self) -> Iterator[Any]:
        return iter(BlockingStream(self._thread, self.inner.feedback))


class BlockingActionClient(BlockingInterface[ActionClient]):
    """Blocking `ActionClient`."""

    def send_goal(self, goal: Any, *, timeout: float = CONNECT_TIMEOUT, cancel_if_lost: bool = False) -> BlockingGoal:
        """Send a goal, and wait until the server has accepted it; see `ActionClient.send_goal`."""
        sending = self.inner.send_goal(goal, timeout=timeout, cancel_if_lost=cancel_if_lost)
        return BlockingGoal(self._thread, self._thread.wait(sending))


class BlockingServerGoal(Blocking[ServerGoal]):
    """Blocking `ServerGoal`, for a handler that runs in a thread and looks at `canceled` from time to time."""

    @property
    def id(self) -> str:
        """UUID of the goal, 32 hex digits."""
        return self.inner.id

    @property
    def request(self) -> Any:
        """The goal's value."""
        return self.inner.request

    @property
    def canceled(self) -> bool:
        """True once its cancellation was asked for."""
        return self.inner.canceled

    def publish_feedback(self, value: Any) -> bool:
        """Send feedback; see `ServerGoal.publish_feedback`."""
        return self._thread.call(lambda: self.inner.publish_feedback(value))


class BlockingActionServer(BlockingInterface[ActionServer]):
    """Blocking `ActionServer`."""


def in_thread(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return a coroutine function that runs `function` in a thread."""
    return lambda value: asyncio.to_thread(function, value)


def goals_in_threads(thread: LoopThread, handler: Callable[[BlockingServerGoal], Any]) -> Handler:
    """Return a coroutine function that carries out each goal in a thread, also when it is to be canceled."""

    async def carry_out(goal: ServerGoal) -> Any:
        work = asyncio.create_task(asyncio.to_thread(handler, BlockingServerGoal(thread, goal)))
        while True:
            try:
                return await asyncio.shield(work)
            except asyncio.CancelledError:
                if not goal.canceled or work.cancelled():
                    raise

    return carry_out

"""Waiting for a mapping node without outliving it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Self, TypeVar

from rce.client import Environment, Event, Reconnected, Robot, Stream
from rce.errors import Died, TimedOut, Unavailable
from rce.protocol.messages import EnvironmentEvent, NodeEvent

T = TypeVar("T")


class NodeGuard:
    """Watches the events of a robot for the end of a node or of its environment. An asynchronous context manager."""

    def __init__(
        self, robot: Robot, environment: Environment, node: str, on_reconnected: Callable[[], Awaitable[None]]
    ) -> None:
        """Watch a node.

        Args:
            robot: Connected robot.
            environment: Environment of the node.
            node: Tag of the node.
            on_reconnected: Called when the robot has a connection again; messages in flight were lost.
        """
        self._robot, self._tag, self._node = robot, environment.tag, node
        self._on_reconnected = on_reconnected

    async def __aenter__(self) -> Self:
        """Start watching."""
        self._failure = asyncio.create_task(self._watch(self._robot.events()))
        return self

    async def __aexit__(self, *_: object) -> None:
        """Stop watching."""
        self._failure.cancel()
        await asyncio.gather(self._failure, return_exceptions=True)

    async def wait(self, work: Coroutine[None, None, T], seconds: float, what: str) -> T:
        """Return the result of `work`, unless the node fails meanwhile.

        Raises:
            Died: The node or its environment ended.
            Unavailable: The robot was closed.
            TimedOut: `work` took longer than `seconds`; `what` names it in the message.
        """
        task = asyncio.ensure_future(work)
        try:
            await asyncio.wait({task, self._failure}, timeout=seconds, return_when=asyncio.FIRST_COMPLETED)
            if task.done():
                return task.result()
            if self._failure.done():
                self._failure.result()
                raise Unavailable(f"the robot was closed while it was waiting for {what}")
            raise TimedOut(f"no answer within {seconds:g} s: waiting for {what}")
        finally:
            task.cancel()

    async def _watch(self, events: Stream[Event]) -> None:
        """Fail when the node or its environment ends.

        Raises:
            Died: The node or its environment ended.
        """
        async for event in events:
            match event:
                case NodeEvent(containerTag=where, nodeTag=name, status=status, lines=lines) if (
                    where == self._tag and name == self._node
                ):
                    raise Died("\n".join([f"the mapping node ended with status {status}", *lines]))
                case EnvironmentEvent(containerTag=where, state="lost" | "gone" | "failed", reason=why) if (
                    where == self._tag
                ):
                    raise Died(f"the environment {self._tag} is lost: {why}")
                case Reconnected():
                    await self._on_reconnected()

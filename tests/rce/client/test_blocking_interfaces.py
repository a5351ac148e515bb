"""Blocking interfaces for actions; test_blocking.py has the others."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, cast

from rce.client.actions import ActionServer, ServerGoal
from rce.client.blocking_interfaces import BlockingServerGoal, goals_in_threads
from rce.client.threads import LoopThread


class Inline:
    """Loop thread for a handler in another thread, where only plain functions are called."""

    def call(self, function: Any) -> Any:
        return function()


class Server:
    """Server that takes the feedback of its goals."""

    tag = "act"

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def _connection(self) -> Any:
        return self

    def room(self, tag: str) -> None: ...

    def _send(self, id: str, phase: str, msg: Any) -> None:
        self.sent.append((phase, msg))


async def test_goal_runs_in_a_thread_until_it_sees_that_it_is_to_be_canceled() -> None:
    began, server = threading.Event(), Server()

    def work(goal: BlockingServerGoal) -> int:
        goal.publish_feedback(goal.request)
        began.set()
        while not goal.canceled:
            threading.Event().wait(0.001)
        return 7

    goal = ServerGoal(cast(ActionServer, server), "1a" * 16, {"order": 1})
    running = asyncio.create_task(goals_in_threads(cast(LoopThread, Inline()), work)(goal))
    await asyncio.to_thread(began.wait, 10)
    goal.canceled = True
    running.cancel()
    assert await running == 7
    assert server.sent == [("feedback", {"order": 1})]

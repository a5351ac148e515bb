"""Time turned by hand, for what waits without sockets."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from hand_turned import HandTurnedLoop


@pytest.fixture
def hand() -> Iterator[HandTurnedLoop]:
    """A loop of its own for the test; fails when an exception was left for nobody."""
    loop = HandTurnedLoop()
    unhandled: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, context: unhandled.append(context))
    yield loop
    for task in asyncio.all_tasks(loop):
        task.cancel()
    loop.settle()
    loop.close()
    assert not unhandled

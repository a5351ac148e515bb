"""Time turned by hand, for what waits without sockets; a database with the user ann."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hand_turned import HandTurnedLoop
from peers import LONG, Furnished, Platform
from twisted.internet.base import ReactorBase

from master import attendance
from master.store import Store
from master.users import Users


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


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    yield store
    await store.close()


@pytest.fixture
async def users(store: Store) -> Users:
    users = Users(store)
    await users.add("ann", "secret")
    return users


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Platform]:
    monkeypatch.setattr(attendance, "RETRY_FIRST", 0.0)
    platform = Platform(reactor, f"sqlite:///{tmp_path / 'master.db'}", LONG)
    await platform.start()
    await platform.master.users.add("ann", "secret")
    await platform.master.users.add("bob", "secret")
    yield platform
    await platform.stop()


@pytest.fixture
async def furnished(platform: Platform) -> Furnished:
    return await Furnished(platform).build()

"""Limits in the database: the platform's, those of one user, and changes while the Master runs."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from master.access import user_limits as module
from master.access.user_limits import UserLimits
from master.access.users import Users
from master.graph.limits import Policy
from master.storage.store import Store


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    store = Store(f"sqlite:///{tmp_path / 'master.db'}")
    await store.open()
    await Users(store).add("ann", "secret")
    yield store
    await store.close()


async def test_changed_limits_override_those_of_the_platform(store: Store) -> None:
    limits = UserLimits(store, Policy(size=2, memory=100, images=["rce/base"]))
    await limits.open()
    await limits.change("ann", {"memory": 200, "images": ["mine/*"], "cpu": 1.5})
    assert limits.of("ann") == Policy(size=2, memory=200, cpu=1.5, images=["rce/base", "mine/*"])
    assert limits.of("bob") == Policy(size=2, memory=100, images=["rce/base"])
    await limits.change("ann", {"memory": None, "images": None, "cpu": None})
    assert limits.of("ann") == limits.of("bob")


async def test_limits_of_users_survive_a_restart(store: Store) -> None:
    first = UserLimits(store, Policy(size=2))
    await first.open()
    await first.change("ann", {"memory": 200})
    second = UserLimits(store, Policy(size=3))
    await second.open()
    assert second.of("ann") == Policy(size=3, memory=200)


async def test_running_master_sees_changes_by_other_processes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REFRESH", 0.001)
    running, other = UserLimits(store, Policy(size=2)), UserLimits(store)
    await running.open()
    await other.open()
    following = asyncio.create_task(running.follow())
    await other.change("ann", {"size": 5})

    async def seen() -> None:
        while running.of("ann").size != 5:  # noqa: ASYNC110  # what is looked at has no event of its own
            await asyncio.sleep(0.001)

    await asyncio.wait_for(seen(), 20)
    following.cancel()
    assert other.of("bob").size == 2


async def test_limits_are_removed_with_their_user(store: Store) -> None:
    limits = UserLimits(store, Policy())
    await limits.open()
    await limits.change("ann", {"size": 5})
    await Users(store).remove("ann")
    await limits.open()
    assert limits.of("ann") == Policy()


async def test_command_shows_and_changes_limits(store: Store, tmp_path: Path) -> None:
    def command(*words: str) -> subprocess.CompletedProcess[str]:
        line = [sys.executable, "-P", "-m", "master.access.accounts", "--data-dir", str(tmp_path), "limits", *words]
        return subprocess.run(line, capture_output=True, text=True, timeout=60)

    await UserLimits(store, Policy(size=4)).open()
    changed = await asyncio.to_thread(command, "ann", "memory=2GiB", "images=mine/*")
    assert changed.returncode == 0, changed.stderr
    assert ["memory", "2147483648", "own"] in [line.split() for line in changed.stdout.splitlines()]
    shown = await asyncio.to_thread(command, "ann", "--json")
    assert json.loads(shown.stdout)["size"] == 4
    assert json.loads(shown.stdout)["images"] == ["mine/*"]
    more = await asyncio.to_thread(command, "ann", "images+=users/ann/tools", "images+=mine/*", "--json")
    assert json.loads(more.stdout)["images"] == ["mine/*", "users/ann/tools"]
    for words, reason in ((("nobody",), "no user nobody"), (("ann", "memory=x"), "memory=x")):
        refused = await asyncio.to_thread(command, *words)
        assert refused.returncode == 1
        assert reason in refused.stderr
        assert "Traceback" not in refused.stderr

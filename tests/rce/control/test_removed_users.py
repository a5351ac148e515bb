"""Things of removed users are removed once, also by a process that was away."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.control.calls.joining import SetRemovedUsers
from rce.control.removed_users import RemovedUsers


class Keeper:
    """Process that keeps things of users in `file`'s directory."""

    def __init__(self, file: Path) -> None:
        self.forgotten: list[str] = []
        self.fails = ""
        self.removed = RemovedUsers(file, self.forget)

    async def forget(self, user: str) -> None:
        if user == self.fails:
            raise OSError("disk is broken")
        self.forgotten.append(user)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "removed-users"


async def test_each_removal_is_carried_out_once(file: Path) -> None:
    keeper = Keeper(file)
    await keeper.removed.update(SetRemovedUsers({"bob": 2.0, "ann": 1.0}))
    await keeper.removed.update(SetRemovedUsers({"ann": 1.0, "bob": 2.0}))
    assert keeper.forgotten == ["ann", "bob"]
    await keeper.removed.update(SetRemovedUsers({"bob": 2.0, "ann": 3.0}))  # ann was added and removed again
    assert keeper.forgotten == ["ann", "bob", "ann"]


async def test_process_that_was_away_carries_out_what_it_missed(file: Path) -> None:
    await Keeper(file).removed.update(SetRemovedUsers({"ann": 1.5}))
    later = Keeper(file)
    await later.removed.update(SetRemovedUsers({"ann": 1.5, "bob": 2.0}))
    assert later.forgotten == ["bob"]


async def test_removal_that_failed_is_repeated(file: Path) -> None:
    keeper = Keeper(file)
    keeper.fails = "bob"
    with pytest.raises(OSError, match="broken"):
        await keeper.removed.update(SetRemovedUsers({"ann": 1.0, "bob": 2.0, "eve": 3.0}))
    keeper.fails = ""
    await keeper.removed.update(SetRemovedUsers({"ann": 1.0, "bob": 2.0, "eve": 3.0}))
    assert keeper.forgotten == ["ann", "bob", "eve"]

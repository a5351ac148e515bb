"""Placements settle once."""

from __future__ import annotations

import pytest

from containers.agents.placements import Placement
from rce.errors import StartFailed


async def test_placement_settles_once() -> None:
    placement = Placement("1")
    assert placement.settle()
    assert not placement.settle(StartFailed("too late"))
    await placement.settled


async def test_who_waits_gets_the_error() -> None:
    placement = Placement("1")
    assert placement.settle(StartFailed("no node"))
    with pytest.raises(StartFailed, match="no node"):
        await placement.settled

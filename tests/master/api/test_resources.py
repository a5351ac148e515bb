"""The API as it is put together: views agree with each other, and what goes on for ever ends with the server."""

from __future__ import annotations

import asyncio
from pathlib import Path

from twisted.internet.base import ReactorBase

from tests.support.master.served import Served, serve
from tests.support.master.sse import follow
from tests.support.master.watch import watch


async def test_resources_are_the_same_in_lists_and_alone(populated: Served) -> None:
    for many, one in (
        ("/robots", "/robots/r1"),
        ("/environments", "/environments/brain"),
        ("/environments/brain/nodes", "/environments/brain/nodes/talker"),
        ("/environments/brain/parameters?node=talker", "/environments/brain/parameters/rate?node=talker"),
        ("/interfaces?owner=brain", "/interfaces/brain/out"),
        ("/connections", "/connections/brain/out/r1/in"),
        ("/groups", "/groups/team"),
    ):
        alone = await populated.ask("GET", one)
        assert alone.status == 200, one
        assert (await populated.ask("GET", many)).body == {"items": [alone.body], "next": ""}, many


async def test_stopping_closes_watchers_and_streams(reactor: ReactorBase, tmp_path: Path) -> None:
    async with serve(reactor, tmp_path) as served:
        watcher = await watch(served, "ann")
        follower = await follow(served, "/events", "ann")
    await asyncio.wait_for(watcher.socket.wait_closed(), 20)
    assert watcher.socket.close_code == 1001
    assert await follower.next() is None
    await follower.close()

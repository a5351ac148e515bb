"""Credentials that are void close the sockets that were opened with them, at once."""

from __future__ import annotations

import asyncio

from platforms import Platform
from raw_robot import USER

from rce.roles import Scopes

SOON = 1.0  # seconds; what is bound by a deadline is not measured, but must not hang
POLICY_VIOLATION = 1008


async def test_a_revoked_key_closes_its_sockets_and_no_others(platform: Platform) -> None:
    secret, key = await platform.master.users.keys.add(USER)
    old = await platform.robot("old", key=secret)
    new = await platform.robot("new", "events,resume", key=secret)
    by_password = await platform.robot("other")
    token = (await new.take())["data"]["token"]
    await old.add("out", "SubscriberConverter")
    await platform.master.guard.revoke_key(USER, key.id)
    async with asyncio.timeout(SOON):
        for robot in (old, new):
            assert await robot.closed() == (POLICY_VIOLATION, "the API key was revoked")
    assert {robot.name for robot in platform.master.state.robots} == {f"{USER}/other"}
    assert not platform.master.state.interfaces.by(f"{USER}/old")
    await by_password.silent()
    again = await platform.robot("new", "events,resume", resume=token)  # what it had is gone with its session
    assert (await again.take())["data"]["resumed"] is False


async def test_a_changed_password_closes_what_was_opened_with_it(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER)
    by_password, by_key = await platform.robot("a"), await platform.robot("b", key=secret)
    await platform.master.guard.change_password(USER, "another one")
    async with asyncio.timeout(SOON):
        assert await by_password.closed() == (POLICY_VIOLATION, "the password was changed")
    await by_key.silent()


async def test_a_tied_key_is_one_robot_and_sees_no_other(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER, scopes=Scopes("mine", ["home"]))
    await platform.robot("theirs")
    mine = await platform.robot("mine", "ack,events", key=secret)
    await mine.take()
    for command in (
        {"type": "CC", "data": {"containerTag": "away"}},
        {"type": "DC", "data": {"containerTag": "away"}},
        {"type": "CX", "data": {"disconnect": [{"tagA": "theirs/x", "tagB": "mine/x"}]}},
    ):
        await mine.send({**command, "id": 1})
    answers = await mine.take_all(3)
    assert [answer["error"]["code"] for answer in answers] == ["forbidden", "not_found", "not_found"]
    await mine.add("out", "SubscriberConverter", of="theirs")
    assert "there is no robot 'theirs'" in (await mine.take())["data"]
    await mine.add("out", "SubscriberConverter")
    await mine.silent()
    await mine.data("out2", {"data": "x"})  # of nobody
    await mine.data("theirs/out", {"data": "x"})  # of another robot
    for answer in await mine.take_all(2):
        assert answer["error"]["code"] == "not_found"

"""Revocation of credentials closes the sockets that were opened with them."""

from __future__ import annotations

from rce.api.roles import Scopes
from tests.support.endpoints.platforms import Platform
from tests.support.endpoints.raw_robot import USER

POLICY_VIOLATION = 1008


async def test_revoked_key_closes_only_its_sockets(platform: Platform) -> None:
    secret, key = await platform.master.users.keys.add(USER)
    old = await platform.robot("old", key=secret)
    new = await platform.robot("new", "events,resume", key=secret)
    by_password = await platform.robot("other")
    token = (await new.receive())["data"]["token"]
    await old.add("out", "SubscriberConverter")
    await platform.master.guard.revoke_key(USER, key.id)
    for robot in (old, new):
        assert await robot.closed() == (POLICY_VIOLATION, "the API key was revoked")
    assert {robot.name for robot in platform.master.state.robots} == {f"{USER}/other"}
    assert not platform.master.state.interfaces.by(f"{USER}/old")
    await by_password.expect_silence()
    again = await platform.robot("new", "events,resume", resume=token)  # the session has ended
    assert (await again.receive())["data"]["resumed"] is False


async def test_changed_password_closes_its_sockets(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER)
    by_password, by_key = await platform.robot("a"), await platform.robot("b", key=secret)
    await platform.master.guard.change_password(USER, "another one")
    assert await by_password.closed() == (POLICY_VIOLATION, "the password was changed")
    await by_key.expect_silence()


async def test_scoped_key_cannot_see_other_robots(platform: Platform) -> None:
    secret, _ = await platform.master.users.keys.add(USER, scopes=Scopes("mine", ["home"]))
    await platform.robot("theirs")
    mine = await platform.robot("mine", "ack,events", key=secret)
    await mine.receive()
    for command in (
        {"type": "CC", "data": {"containerTag": "away"}},
        {"type": "DC", "data": {"containerTag": "away"}},
        {"type": "CX", "data": {"disconnect": [{"tagA": "theirs/x", "tagB": "mine/x"}]}},
    ):
        await mine.send({**command, "id": 1})
    answers = await mine.receive_all(3)
    assert [answer["error"]["code"] for answer in answers] == ["forbidden", "not_found", "not_found"]
    await mine.add("out", "SubscriberConverter", of="theirs")
    assert "there is no robot 'theirs'" in (await mine.receive())["data"]
    await mine.add("out", "SubscriberConverter")
    await mine.expect_silence()
    await mine.data("out2", {"data": "x"})  # does not exist
    await mine.data("theirs/out", {"data": "x"})  # belongs to another robot
    for answer in await mine.receive_all(2):
        assert answer["error"]["code"] == "not_found"

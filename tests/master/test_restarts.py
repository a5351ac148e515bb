"""The Master dies, and the next one takes up its work."""

from __future__ import annotations

import pytest
from peers import Furnished, Platform, execute, login

from rce import messages as m
from rce.calls.endpoints import (
    CloseLink,
    OpenLink,
    Sync,
)
from rce.calls.environments import (
    KeepEnvironments,
    StartEnvironment,
)
from rce.calls.robots import Login
from rce.errors import AlreadyExists, Unauthorized


async def restart(furnished: Furnished) -> Platform:
    platform = furnished.platform
    await platform.stop()
    await platform.start()
    return platform


async def test_after_a_restart_all_is_as_it_was(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    m1 = await platform.process(
        "container", "m1", capacity=4, token=furnished.m1.credential, environments={"ann/brain": run}
    )
    brain = await platform.process("environment", "ann/brain", run, token=furnished.brain.credential)
    assert (await m1.next(KeepEnvironments)).runs == [run]
    for peer in (west, brain):
        sync = await peer.next(Sync)
        assert ([link.name for link in sync.links], len(sync.routes)) == ([furnished.link], 1)
    for command in (
        m.CreateContainer("brain"),
        m.AddInterface("r1", "pose", "SubscriberConverter", "std_msgs/String"),
        m.Connect("r1/pose", "brain/pose"),
    ):
        await execute(west, "ann/r1", command, again=True)
        with pytest.raises(AlreadyExists):
            await execute(west, "ann/r1", command)
    for peer in (west, brain, m1):
        assert not [call for call in peer.arrived if isinstance(call, OpenLink | StartEnvironment | CloseLink)]
    assert (await login(west, "ann/r1", furnished.session.token)).resumed


async def test_after_a_restart_a_new_process_gets_links_anew(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    m1 = await platform.process("container", "m1", capacity=4, token=furnished.m1.credential)
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != run
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    assert (await west.next(Sync)).routes == []
    await platform.process("environment", spec.name, token=spec.token)
    assert (await west.next(OpenLink)).link.name != furnished.link


async def test_who_does_not_come_back_after_a_restart_is_given_up(furnished: Furnished) -> None:
    furnished.platform.grace = 0.0
    platform = await restart(furnished)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_an_environment_that_was_removed_may_not_join(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))
    with pytest.raises(Unauthorized):
        await furnished.platform.process("environment", "ann/brain", token=furnished.brain.credential)


async def test_a_key_that_is_revoked_while_the_master_is_away_closes_its_sockets(platform: Platform) -> None:
    west = await platform.endpoint()
    secret, key = await platform.master.users.keys.add("ann")
    await west.call(Login("ann", "by_key", secret))
    await login(west, "ann/by_password")
    await platform.stop()
    await platform.start()
    await platform.master.users.keys.revoke("ann", key.id)
    await platform.master.guard.look_round()
    assert [robot.name for robot in platform.master.state.robots] == ["ann/by_password"]

"""Restart of the Master: the next one continues."""

from __future__ import annotations

import pytest

from rce.control.calls.endpoints import CloseLink, OpenLink, Sync
from rce.control.calls.environments import KeepEnvironments, StartEnvironment
from rce.control.calls.robots import Login
from rce.errors import AlreadyExists, Unauthorized
from rce.protocol import messages as m
from tests.support.master.peers import Furnished, Platform, execute, login


async def restart(furnished: Furnished) -> Platform:
    platform = furnished.platform
    await platform.stop()
    await platform.start()
    return platform


async def test_state_survives_a_restart_of_the_master(furnished: Furnished) -> None:
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


async def test_new_process_gets_new_links_after_a_restart_of_the_master(furnished: Furnished) -> None:
    run = furnished.platform.master.state.environments["ann/brain"].run
    platform = await restart(furnished)
    m1 = await platform.process("container", "m1", capacity=4, token=furnished.m1.credential)
    spec = (await m1.next(StartEnvironment)).environment
    assert spec.run != run
    west = await platform.endpoint(token=furnished.west.credential, robots=["ann/r1"])
    assert (await west.next(Sync)).routes == []
    await platform.process("environment", spec.name, token=spec.token)
    assert (await west.next(OpenLink)).link.name != furnished.link


async def test_processes_that_do_not_return_after_a_restart_are_removed(furnished: Furnished) -> None:
    furnished.platform.grace = 0.0
    platform = await restart(furnished)
    await platform.until(lambda: len(platform.master.state.robots) == 0)
    assert "ann/brain" in platform.master.state.environments


async def test_removed_environment_cannot_join(furnished: Furnished) -> None:
    await execute(furnished.west, "ann/r1", m.DestroyContainer("brain"))
    with pytest.raises(Unauthorized):
        await furnished.platform.process("environment", "ann/brain", token=furnished.brain.credential)


async def test_key_revoked_while_the_master_is_down_closes_its_sockets(platform: Platform) -> None:
    west = await platform.endpoint()
    secret, key = await platform.master.users.keys.add("ann")
    await west.call(Login("ann", "by_key", secret))
    await login(west, "ann/by_password")
    await platform.stop()
    await platform.start()
    await platform.master.users.keys.revoke("ann", key.id)
    await platform.master.guard.check_all()
    assert [robot.name for robot in platform.master.state.robots] == ["ann/by_password"]

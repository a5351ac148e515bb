"""Processes join the Master, services act for its users."""

from __future__ import annotations

import asyncio

import pytest
from peers import PATIENCE, Peer, Platform

import rce
from master.audit import Wanted
from master.users import digest
from rce.calls.endpoints import (
    Sync,
)
from rce.calls.joining import Hello
from rce.calls.robots import Login
from rce.calls.services import Borrow, Delegate, EndGrant, NoteDone, Person, Vouch
from rce.errors import Forbidden, InvalidRequest, Unauthorized


async def test_a_token_lets_in_once_and_the_credential_again(platform: Platform) -> None:
    await platform.master.processes.allow("west", "robot", "one-time")
    west = await platform.endpoint(token="one-time")
    with pytest.raises(Unauthorized):
        await platform.endpoint(token="one-time")
    again = await platform.endpoint(token=west.credential)
    assert again.credential == west.credential


@pytest.mark.parametrize(
    ("hello", "error"),
    [
        (Hello("robot", "west", "wrong", rce.__version__), Unauthorized),
        (Hello("container", "west", "t", rce.__version__), Unauthorized),
        (Hello("robot", "east", "t", rce.__version__), Unauthorized),
        (Hello("robot", "west", "t", "0.0.0"), InvalidRequest),
    ],
)
async def test_who_may_not_join(platform: Platform, hello: Hello, error: type[Exception]) -> None:
    await platform.master.processes.allow("west", "robot", "t")
    with pytest.raises(error):
        await Peer(platform, hello).join()
    assert not platform.master.state.joined


async def test_a_process_that_comes_twice_is_there_once(platform: Platform) -> None:
    first = await platform.endpoint()
    second = await platform.endpoint(token=first.credential)
    await asyncio.wait_for(first.control.lost, PATIENCE)
    assert "west" in platform.master.state.joined
    await second.next(Sync)


async def test_a_service_acts_for_a_user_as_a_robot_of_theirs(platform: Platform) -> None:
    maps = await platform.process("service", "map-service", url="http://:9020/")
    west = await platform.endpoint()
    assert await maps.call(Vouch("ann", digest("secret"))) == Person("ann", "user")
    grant = await maps.call(Delegate("ann", digest("secret")))
    lent = await maps.call(Borrow(grant.grant, 60))
    assert await west.call(Login("ann", "mapper", lent.key))
    for call in (Vouch("ann", lent.key), Delegate("ann", lent.key)):
        with pytest.raises(Forbidden):
            await maps.call(call)
    await maps.call(EndGrant(grant.grant))
    with pytest.raises(Unauthorized):
        await west.call(Login("ann", "other", lent.key))


async def test_a_service_acts_for_those_only_who_prove_themselves_and_may_use_robots(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    await platform.master.users.add("root", "secret", "admin")
    key, _ = await platform.master.users.keys.add("ann", "viewer")
    for call, error in (
        (Delegate("ann", digest("wrong")), Unauthorized),
        (Delegate("root", digest("secret")), Forbidden),
        (Vouch("", key), Forbidden),
        (Borrow("0" * 32, 60), Unauthorized),
    ):
        with pytest.raises(error):
            await maps.call(call)


async def test_what_a_service_tells_and_whom_it_is_refused_is_in_the_audit_log(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    person = await maps.call(Vouch("ann", digest("secret"), "job.read", "10.0.0.1"))
    await maps.call(NoteDone(person, "job.cancel", "ann/0", "not_found", "10.0.0.1"))
    with pytest.raises(Unauthorized):
        await maps.call(Vouch("ann", digest("wrong"), "job.read", "10.0.0.1"))
    found = await platform.master.audit.find(Wanted(), None, 10)
    assert [(each.user, each.action, each.object, each.result, each.origin) for each in found] == [
        ("", "login", "ann", "unauthorized", "map-service 10.0.0.1"),
        ("ann", "job.cancel", "ann/0", "not_found", "map-service 10.0.0.1"),
    ]


async def test_only_services_act_for_users(platform: Platform) -> None:
    west = await platform.endpoint()
    with pytest.raises(InvalidRequest, match="does not answer"):
        await west.call(Delegate("ann", digest("secret")))

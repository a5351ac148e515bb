"""Processes join the Master by tokens; services act for users."""

from __future__ import annotations

import asyncio

import pytest

import rce
from master.access.audit import AuditFilter
from master.access.users import digest
from rce.control.calls.endpoints import Sync
from rce.control.calls.joining import Hello
from rce.control.calls.robots import Login
from rce.control.calls.services import Authenticate, CreateGrant, Identity, IssueKey, RecordAction, RevokeGrant
from rce.errors import Forbidden, InvalidRequest, Unauthorized
from tests.support.master.peers import PATIENCE, Peer, Platform


async def test_token_admits_once_and_the_credential_again(platform: Platform) -> None:
    await platform.master.join_tokens.allow("west", "robot", "one-time")
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
async def test_processes_without_valid_token_are_refused(
    platform: Platform, hello: Hello, error: type[Exception]
) -> None:
    await platform.master.join_tokens.allow("west", "robot", "t")
    with pytest.raises(error):
        await Peer(platform, hello).join()
    assert not platform.master.state.joined


async def test_second_connection_of_a_process_replaces_the_first(platform: Platform) -> None:
    first = await platform.endpoint()
    second = await platform.endpoint(token=first.credential)
    await asyncio.wait_for(first.control.lost, PATIENCE)
    assert "west" in platform.master.state.joined
    await second.next(Sync)


async def test_service_acts_for_a_user_as_a_robot(platform: Platform) -> None:
    maps = await platform.process("service", "map-service", url="http://:9020/")
    west = await platform.endpoint()
    assert await maps.call(Authenticate("ann", digest("secret"))) == Identity("ann", "user")
    grant = await maps.call(CreateGrant("ann", digest("secret")))
    lent = await maps.call(IssueKey(grant.grant, 60))
    assert await west.call(Login("ann", "mapper", lent.key))
    for call in (Authenticate("ann", lent.key), CreateGrant("ann", lent.key)):
        with pytest.raises(Forbidden):
            await maps.call(call)
    await maps.call(RevokeGrant(grant.grant))
    with pytest.raises(Unauthorized):
        await west.call(Login("ann", "other", lent.key))


async def test_service_acts_only_for_authenticated_users_with_robots(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    await platform.master.users.add("root", "secret", "admin")
    key, _ = await platform.master.users.keys.add("ann", "viewer")
    for call, error in (
        (CreateGrant("ann", digest("wrong")), Unauthorized),
        (CreateGrant("root", digest("secret")), Forbidden),
        (Authenticate("", key), Forbidden),
        (IssueKey("0" * 32, 60), Unauthorized),
    ):
        with pytest.raises(error):
            await maps.call(call)


async def test_actions_and_refusals_of_services_are_audited(platform: Platform) -> None:
    maps = await platform.process("service", "map-service")
    person = await maps.call(Authenticate("ann", digest("secret"), "job.read", "10.0.0.1"))
    await maps.call(RecordAction(person, "job.cancel", "ann/0", "not_found", "10.0.0.1"))
    with pytest.raises(Unauthorized):
        await maps.call(Authenticate("ann", digest("wrong"), "job.read", "10.0.0.1"))
    found = await platform.master.audit.find(AuditFilter(), None, 10)
    assert [(each.user, each.action, each.object, each.result, each.origin) for each in found] == [
        ("", "login", "ann", "unauthorized", "map-service 10.0.0.1"),
        ("ann", "job.cancel", "ann/0", "not_found", "map-service 10.0.0.1"),
    ]


async def test_only_services_may_act_for_users(platform: Platform) -> None:
    west = await platform.endpoint()
    with pytest.raises(InvalidRequest, match="does not answer"):
        await west.call(CreateGrant("ann", digest("secret")))

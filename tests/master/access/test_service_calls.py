"""Services act for users who authenticate at them, as robots only."""

from __future__ import annotations

import pytest

from master.access.audit import AuditFilter
from master.access.users import digest
from rce.control.calls.robots import Login
from rce.control.calls.services import Authenticate, CreateGrant, Identity, IssueKey, RecordAction, RevokeGrant
from rce.errors import Forbidden, InvalidRequest, Unauthorized
from tests.support.master.peers import Platform


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
        (Authenticate("ann", digest("secret"), "user.remove"), InvalidRequest),
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

"""Credentials of requests: which are accepted, and what the audit log has of a request."""

from __future__ import annotations

import base64

import pytest

from master.access.audit import Audit, AuditFilter
from master.access.throttle import Throttle
from master.access.users import Users, digest
from master.api.authentication import Authenticator, credentials
from master.api.request import Answer, Call
from master.storage.store import Store
from rce.api import http as client
from rce.api.roles import Principal
from rce.api.views import AuditView
from rce.errors import Forbidden, InternalError, NotFound, Unauthorized
from tests.support.master.calls import make_call
from tests.support.master.package_platform import PackagePlatform
from tests.support.master.served import Served

ANN = Principal("ann", "user", "k1")
KEY = "rce_0123"
HASH = digest("secret")


def basic(text: str) -> str:
    return "Basic " + base64.b64encode(text.encode()).decode()


@pytest.mark.parametrize(
    ("header", "found"),
    [
        (f"Bearer {KEY}", ("", KEY)),
        (f"bearer  {KEY} ", ("", KEY)),
        (basic(f"ann:{KEY}"), ("ann", KEY)),
        (basic("ann:secret"), ("ann", HASH)),
        (basic(f"ann:{HASH}"), ("ann", HASH)),
        (basic("ann:se:cret"), ("ann", digest("se:cret"))),
        (basic("ann:"), ("ann", digest(""))),
        (basic("ünn:ß"), ("ünn", digest("ß"))),
        (basic(f":{KEY}"), ("", KEY)),
    ],
)
def test_credentials_are_a_key_a_password_or_its_hash(header: str, found: tuple[str, str]) -> None:
    assert credentials(make_call(None, headers={"Authorization": header}).request) == found


@pytest.mark.parametrize(
    "header",
    ["", "Basic", "Basic !", "Basic YW5u", "Basic /w==", "Bearer x", "Bearer", f"Digest {KEY}", "Basic \xff", KEY],
)
def test_malformed_credentials_are_refused(header: str) -> None:
    with pytest.raises(Unauthorized, match="credentials are missing"):
        credentials(make_call(None, headers={"Authorization": header}).request)


# --- audit ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def audit(store: Store) -> Audit:
    return Audit(store)


@pytest.fixture
def authenticator(store: Store, audit: Audit) -> Authenticator:
    return Authenticator(Users(store), audit)


async def entries(audit: Audit) -> list[AuditView]:
    return (await audit.find(AuditFilter(), None, 100))[::-1]


async def test_failed_login_is_recorded_without_its_secret(
    authenticator: Authenticator, audit: Audit, users: Users
) -> None:
    right, wrong = (make_call(None, headers=client.basic("ann", word)).request for word in ("secret", "wrong"))
    assert (await authenticator.authenticate(right)).user == "ann"
    with pytest.raises(Unauthorized):
        await authenticator.authenticate(wrong)
    (entry,) = await entries(audit)
    assert (entry.user, entry.action, entry.object, entry.result) == ("", "login", "ann", "unauthorized")
    assert (entry.door, entry.address) == ("rest", "10.0.0.1")
    assert digest("wrong") not in str(entry)


@pytest.mark.parametrize(
    ("method", "error", "result"),
    [
        ("GET", None, None),
        ("HEAD", None, None),
        ("GET", NotFound("no"), None),
        ("GET", Forbidden("no"), "forbidden"),
        ("POST", None, "ok"),
        ("DELETE", NotFound("no"), "not_found"),
        ("PUT", InternalError("oh"), "internal"),
        ("PATCH", ZeroDivisionError(), "internal"),
    ],
)
async def test_changes_and_forbidden_reads_are_recorded(
    authenticator: Authenticator, audit: Audit, method: str, error: Exception | None, result: str | None
) -> None:
    async def handler(call: Call) -> Answer:
        call.audit.operation, call.audit.owner, call.audit.names = "node.create", "bob", ["n"]
        if error is not None:
            raise error
        return Answer(status=204)

    call = make_call(ANN, method, variables={"environment": "brain"})
    if error is None:
        assert (await authenticator.audited(call, handler)).status == 204
    else:
        with pytest.raises(type(error)):
            await authenticator.audited(call, handler)
    recorded = [(each.user, each.key, each.action, each.object, each.result) for each in await entries(audit)]
    assert recorded == ([("ann", "k1", "node.create", "bob/brain/n", result)] if result else [])


async def test_request_that_is_refused_before_its_operation_is_known_is_recorded_by_its_path(
    authenticator: Authenticator, audit: Audit
) -> None:
    async def handler(call: Call) -> Answer:
        raise NotFound("no")

    with pytest.raises(NotFound):
        await authenticator.audited(make_call(ANN, "POST", f"/api/v1/{'x' * 100}?q=1"), handler)
    (entry,) = await entries(audit)
    assert (entry.action, entry.object) == (f"POST /api/v1/{'x' * 42}", "")


async def test_upload_with_a_ticket_is_recorded_for_its_owner(authenticator: Authenticator, audit: Audit) -> None:
    async def handler(call: Call) -> Answer:
        call.audit.operation, call.audit.owner, call.audit.names = "package.push", "ann", ["tool"]
        return Answer(status=201)

    await authenticator.audited(make_call(None, "PUT"), handler)
    (entry,) = await entries(audit)
    assert (entry.user, entry.action, entry.object) == ("ann", "package.push", "ann/tool")


# --- over HTTP --------------------------------------------------------------------------------------------------------


async def test_password_guessing_is_throttled(served: Served) -> None:
    served.master.users.throttle = Throttle(lambda: 0.0)
    for user in ("ann", "nobody"):
        answers = [await served.ask("GET", "/whoami", user, secret="wrong") for _ in range(6)]
        assert [answer.status for answer in answers] == [401] * 5 + [429]
        assert answers[-1].headers["retry-after"] == "1"
        assert answers[-1].body["fields"]["retry_after"] == 1
    assert (await served.ask("GET", "/whoami")).status == 429


async def test_api_key_and_hash_of_the_password_are_accepted(platform: PackagePlatform) -> None:
    key, _ = await platform.master.users.keys.add("ann", "user")
    await platform.do("ann", lambda packages: packages.push("tool", platform.entries()), key)
    assert len(await platform.do("ann", lambda packages: packages.list(), HASH)) == 1
    status, _ = await platform.raw("GET", "/api/v1/packages", headers=client.bearer(key))
    assert status == 200
    with pytest.raises(Unauthorized):
        await platform.do("bob", lambda packages: packages.list(), key)


async def test_no_route_of_packages_is_open_to_wrong_credentials(platform: PackagePlatform) -> None:
    for method, path, headers in (
        *((method, "/api/v1/packages", client.basic("ann", "wrong")) for method in ("GET", "POST")),
        ("DELETE", "/api/v1/packages/p", client.bearer("rce_x")),
        ("PUT", "/api/v1/uploads", client.bearer("x")),
        ("GET", "/api/v1/archives", client.bearer("x")),
        ("GET", "/api/v1/packages", {}),
    ):
        status, problem = await platform.raw(method, path, b"x" * (method == "PUT"), headers)
        assert (status, problem["code"], problem["status"]) == (401, "unauthorized", 401), path

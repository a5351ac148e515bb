"""Packages over HTTP: push, list and share, what is refused, and that refused uploads leave nothing."""

from __future__ import annotations

import asyncio
import hashlib
from pathlib import Path
from typing import Any

import msgspec
import pytest

from master.graph.records import Environment, EnvironmentOptions, Process
from rce.api import http as client
from rce.control.calls.environments import FetchPackage
from rce.errors import Forbidden, LimitExceeded, NotFound, Unauthorized
from rce.packages.client import Package
from tests.support.master.package_platform import QUOTA, PackagePlatform, announce, packed
from tests.support.master.served import PASSWORD


async def names(platform: PackagePlatform, user: str) -> set[str]:
    return {package.name for package in await platform.do(user, lambda packages: packages.list())}


async def push(platform: PackagePlatform, user: str, name: str) -> None:
    await platform.do(user, lambda packages: packages.push(name, platform.entries()))


async def test_package_is_pushed_listed_shared_and_removed(platform: PackagePlatform) -> None:
    first = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    again = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    assert first == again
    (seen,) = await platform.do("ann", lambda packages: packages.list())
    assert isinstance(seen, Package)
    assert (seen.name, [each.digest for each in seen.versions], seen.shared) == ("ann/tool", [first.digest], [])
    assert seen.versions[0].packages == ["p"]
    assert platform.stored() == {first.digest}
    assert (platform.files / "depot" / first.digest).stat().st_mode & 0o777 == 0o400
    assert await names(platform, "bob") == set()
    await platform.do("ann", lambda packages: packages.share("tool", ["bob"]))
    (seen,) = await platform.do("bob", lambda packages: packages.list())
    assert (seen.name, seen.shared) == ("ann/tool", [])  # with whom else is not bob's business
    assert await names(platform, "eve") == set()
    await platform.do("ann", lambda packages: packages.unshare("tool", []))
    assert await names(platform, "bob") == set()
    second = await platform.do("ann", lambda packages: packages.push("tool", platform.entries(b"y")))
    await platform.do("ann", lambda packages: packages.remove("tool", first.digest[:12]))
    assert platform.stored() == {second.digest}
    await platform.do("ann", lambda packages: packages.remove("tool"))
    assert platform.stored() == set()


async def test_lists_come_in_pages(platform: PackagePlatform, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("c", "a", "b"):
        await push(platform, "ann", name)
    await push(platform, "bob", "d")
    await platform.do("bob", lambda packages: packages.share("d", ["*"]))
    seen = (await platform.raw("GET", "/api/v1/packages?limit=2", headers=client.basic("ann", PASSWORD)))[1]
    assert ([each["name"] for each in seen["items"]], seen["next"]) == (["ann/a", "ann/b"], "ann/b")
    assert (await platform.raw("GET", "/api/v1/packages?size=2", headers=client.basic("ann", PASSWORD)))[0] == 400
    monkeypatch.setattr("rce.packages.client.PAGE_SIZE", 3)
    found = await platform.do("ann", lambda packages: packages.list())
    assert [each.name for each in found] == ["ann/a", "ann/b", "ann/c", "bob/d"]


@pytest.mark.parametrize("role", ["robot", "viewer"])
async def test_read_only_roles_cannot_push(platform: PackagePlatform, role: Any) -> None:
    key, _ = await platform.master.users.keys.add("ann", role)
    assert await platform.do("ann", lambda packages: packages.list(), key) == []
    for action in (
        lambda packages: packages.push("tool", platform.entries()),
        lambda packages: packages.share("tool", ["bob"]),
        lambda packages: packages.unshare("tool", []),
        lambda packages: packages.remove("tool"),
    ):
        with pytest.raises(Forbidden):
            await platform.do("ann", action, key)
    assert platform.stored() == set()


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "code"),
    [
        ("GET", "/api/v1/nothing", b"", 404, "not_found"),
        ("GET", "/api/v1/packages/", b"", 404, "not_found"),
        ("PATCH", "/api/v1/packages", b"", 405, "method_not_allowed"),
        ("POST", "/api/v1/packages", b"{", 400, "invalid_request"),
        ("POST", "/api/v1/packages", b'{"name":"p","digest":"00","size":1}', 400, "invalid_request"),
        ("POST", "/api/v1/packages", b'{"name":"a/b","digest":"00","size":1}', 400, "invalid_name"),
        ("POST", "/api/v1/packages", b'{"name":"p","digest":"%s","size":0}' % (b"0" * 64), 413, "limit_exceeded"),
        ("POST", "/api/v1/packages", b'{"name":"p","digest":"%s","size":100001}' % (b"0" * 64), 413, "limit_exceeded"),
        ("POST", "/api/v1/packages/p/shares", b'{"users":[]}', 400, "invalid_request"),
        ("POST", "/api/v1/packages/p/shares", b'{"users":["bob"]}', 404, "not_found"),
        ("DELETE", "/api/v1/packages/p/shares/bob", b"", 404, "not_found"),
        ("DELETE", "/api/v1/packages/p/versions/0", b"", 404, "not_found"),
    ],
)
async def test_wrong_requests_are_problems(
    platform: PackagePlatform, method: str, path: str, body: bytes, status: int, code: str
) -> None:
    answer = await platform.raw(method, path, body, client.basic("ann", PASSWORD))
    assert (answer[0], answer[1]["code"]) == (status, code)
    assert answer[1]["detail"]


async def test_package_cannot_be_shared_with_an_unknown_user(platform: PackagePlatform) -> None:
    await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    with pytest.raises(NotFound, match="no user 'carl'"):
        await platform.do("ann", lambda packages: packages.share("tool", ["bob", "carl"]))
    assert await names(platform, "bob") == set()


# --- uploads ---


async def test_upload_ticket_is_valid_once(platform: PackagePlatform) -> None:
    content = packed(platform)
    token = client.bearer(await announce(platform, content))
    assert (await platform.raw("PUT", "/api/v1/uploads", content, token))[0] == 201
    assert (await platform.raw("PUT", "/api/v1/uploads", content, token))[0] == 401
    assert platform.stored() == {hashlib.sha256(content).hexdigest()}


async def test_upload_that_a_removed_user_announced_is_refused(platform: PackagePlatform) -> None:
    content = packed(platform)
    token = client.bearer(await announce(platform, content))
    master = platform.master
    await master.guard.remove_user("ann")
    await master.users.add("ann", PASSWORD)
    assert (await platform.raw("PUT", "/api/v1/uploads", content, token))[0] == 401
    assert platform.stored() == set()
    assert await names(platform, "ann") == set()


async def test_digest_alone_does_not_give_an_archive(platform: PackagePlatform) -> None:
    contents = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    body = {"name": "mine", "digest": contents.digest, "size": contents.size}
    answer = await platform.raw("POST", "/api/v1/packages", msgspec.json.encode(body), client.basic("eve", PASSWORD))
    assert (answer[0], bool(answer[1]["token"])) == (202, True)  # eve must show that she has it
    assert await names(platform, "eve") == set()


@pytest.mark.parametrize(
    ("sent", "status"),
    [(b"", 401), (b"short", 401), (b"another of equal size".ljust(3072, b"x"), 400), (b"\x00" * 3072, 400)],
)
async def test_upload_that_was_not_announced_is_refused(platform: PackagePlatform, sent: bytes, status: int) -> None:
    content = packed(platform)
    assert len(content) == 3072 + 1024
    token = await announce(platform, content[:3072])
    assert (await platform.raw("PUT", "/api/v1/uploads", sent, client.bearer(token)))[0] == status
    assert platform.stored() == set()
    assert platform.depot.pending() == []


async def test_malformed_archive_is_refused(platform: PackagePlatform) -> None:
    token = await announce(platform, b"no archive")
    status, problem = await platform.raw("PUT", "/api/v1/uploads", b"no archive", client.bearer(token))
    assert (status, problem["code"]) == (400, "invalid_request")
    assert platform.stored() == set()


async def test_quota_counts_announced_uploads(platform: PackagePlatform) -> None:
    await announce(platform, b"a", QUOTA // 2)
    await announce(platform, b"b", QUOTA // 2)
    with pytest.raises(LimitExceeded) as raised:
        await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    assert raised.value.info.fields["limit"] == QUOTA
    await platform.do("bob", lambda packages: packages.push("tool", platform.entries()))


async def test_uploads_at_once_are_limited(platform: PackagePlatform) -> None:
    for number in range(4):
        await announce(platform, bytes([number]))
    with pytest.raises(LimitExceeded, match="under way"):
        await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))


# --- downloads by task sets ---


async def test_task_set_fetches_packages_of_its_environments(platform: PackagePlatform, tmp_path: Path) -> None:
    contents = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    master = platform.master
    machine, other = Process("m1", "container", "1", capacity=4), Process("m2", "container", "1")
    master.state.processes.put(machine)
    master.state.joined.add("m1")
    fetch = master._fetch_package
    with pytest.raises(NotFound):
        await fetch(machine, FetchPackage(contents.digest))
    master.state.environments.put(
        Environment("ann/e", EnvironmentOptions(), "0" * 32, "m1", packages=[contents.digest])
    )
    with pytest.raises(NotFound):
        await fetch(other, FetchPackage(contents.digest))
    with pytest.raises(NotFound):
        await fetch(machine, FetchPackage("../master.db"))
    ticket = await fetch(machine, FetchPackage(contents.digest))
    assert (ticket.scheme, ticket.port, ticket.size) == ("http", platform.port, contents.size)

    def get() -> bytes:
        entry = client.EntryClient(f"http://127.0.0.1:{ticket.port}/", client.bearer(ticket.token))
        with entry.open("GET", ticket.path) as answer:
            data: bytes = answer.read()
            return data

    assert hashlib.sha256(await asyncio.to_thread(get)).hexdigest() == contents.digest
    with pytest.raises(Unauthorized):  # it was good once
        await asyncio.to_thread(get)
    await platform.do("ann", lambda packages: packages.remove("tool"))
    assert platform.stored() == {contents.digest}  # the environment has it still
    master.state.environments.drop("ann/e")
    await master.save()
    assert platform.stored() == set()

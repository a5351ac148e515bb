"""Packages over HTTP: push, list and share, what is refused, and that refused uploads leave nothing."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import http.client
import io
import json
import os
import socket
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
from twisted.internet.base import ReactorBase
from twisted.logger import LogEvent

from master.api.packages import PackagesApi
from master.api.router import Api
from master.api.site import Site
from master.graph.limits import Policy
from master.graph.records import Environment, Process
from master.service import Master
from master.storage.depot import Depot, Upload
from master.storage.store import Store
from rce.api import http as client
from rce.control.calls.environments import FetchPackage
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, RceError, Unauthorized
from rce.packages import archive
from rce.packages.client import Package, PackagesClient
from rce.protocol.messages import ContainerData
from rce.web.server import Endpoint

QUOTA = 100_000
PASSWORD = "secret"


class Platform(NamedTuple):
    master: Master
    depot: Depot
    port: int
    files: Path

    def entry(self, user: str, secret: str = PASSWORD) -> client.EntryClient:
        return client.EntryClient(f"http://127.0.0.1:{self.port}/", client.basic(user, secret))

    async def do(self, user: str, action: Callable[[PackagesClient], Any], secret: str = PASSWORD) -> Any:
        return await asyncio.to_thread(action, PackagesClient(self.entry(user, secret)))

    async def raw(self, method: str, path: str, body: bytes = b"", **headers: str) -> tuple[int, dict[str, Any]]:
        def ask() -> tuple[int, dict[str, Any]]:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
            connection.request(method, path, body, {"Connection": "close", **headers})
            response = connection.getresponse()
            answer = response.status, json.loads(response.read() or b"{}")
            connection.close()
            return answer

        return await asyncio.to_thread(ask)

    def stored(self) -> set[str]:
        return {path.name for path in (self.files / "depot").rglob("*") if path.is_file()}

    def entries(self, content: bytes = b"x") -> list[archive.Entry]:
        source = self.files / "file"
        source.write_bytes(content)
        return [archive.Entry("p/package.xml", source, False), archive.Entry("p/talk.py", source, False)]


@pytest.fixture
async def platform(reactor: ReactorBase, tmp_path: Path) -> AsyncIterator[Platform]:
    store = Store("sqlite://")
    await store.open()
    depot = Depot(tmp_path / "depot")
    master = Master(store, 10, Policy(package_bytes=QUOTA), depot=depot)
    for user in ("ann", "bob", "eve"):
        await master.users.add(user, PASSWORD)
    await master.start()
    api = Api(master.users, master.audit)
    PackagesApi(master, depot).add_to(api)
    site = Site(master.state, api, depot)
    _, port = await site.start(Endpoint("127.0.0.1", 0))
    master.entry = ("http", port)
    yield Platform(master, depot, port, tmp_path)
    await site.stop()
    await master.stop()
    await store.close()


def open_files() -> set[str]:
    return {os.path.realpath(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")}


async def names(platform: Platform, user: str) -> set[str]:
    return {package.name for package in await platform.do(user, lambda packages: packages.list())}


async def test_package_is_pushed_listed_shared_and_removed(platform: Platform) -> None:
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


async def test_lists_come_in_pages(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("c", "a", "b"):
        await platform.do("ann", lambda packages, name=name: packages.push(name, platform.entries()))
    await platform.do("bob", lambda packages: packages.push("d", platform.entries()))
    await platform.do("bob", lambda packages: packages.share("d", ["*"]))
    seen = (await platform.raw("GET", "/api/v1/packages?limit=2", **client.basic("ann", PASSWORD)))[1]
    assert ([each["name"] for each in seen["items"]], seen["next"]) == (["ann/a", "ann/b"], "ann/b")
    assert (await platform.raw("GET", "/api/v1/packages?size=2", **client.basic("ann", PASSWORD)))[0] == 400
    monkeypatch.setattr("rce.packages.client.PAGE_SIZE", 3)
    found = await platform.do("ann", lambda packages: packages.list())
    assert [each.name for each in found] == ["ann/a", "ann/b", "ann/c", "bob/d"]


async def test_api_key_and_hash_of_the_password_are_accepted(platform: Platform) -> None:
    key, _ = await platform.master.users.keys.add("ann", "user")
    await platform.do("ann", lambda packages: packages.push("tool", platform.entries()), key)
    hashed = hashlib.sha256(PASSWORD.encode()).hexdigest()
    assert len(await platform.do("ann", lambda packages: packages.list(), hashed)) == 1
    status, _ = await platform.raw("GET", "/api/v1/packages", Authorization=f"Bearer {key}")
    assert status == 200
    with pytest.raises(Unauthorized):
        await platform.do("bob", lambda packages: packages.list(), key)


@pytest.mark.parametrize("role", ["robot", "viewer"])
async def test_read_only_roles_cannot_push(platform: Platform, role: Any) -> None:
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
    "header",
    ["", "Basic", "Basic !", "Basic YW5u", "Basic YW5uOndyb25n", "Bearer x", "Bearer rce_x", "Digest a", "Basic \xff"],
)
async def test_wrong_credentials_are_refused(platform: Platform, header: str) -> None:
    for method, path in (("GET", "/api/v1/packages"), ("POST", "/api/v1/packages"), ("DELETE", "/api/v1/packages/p")):
        status, problem = await platform.raw(method, path, Authorization=header)
        assert (status, problem["code"], problem["status"]) == (401, "unauthorized", 401)
    status, problem = await platform.raw("PUT", "/api/v1/uploads", b"x", Authorization=header)
    assert status == 401
    status, problem = await platform.raw("GET", "/api/v1/archives", Authorization=header)
    assert status == 401


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
    platform: Platform, method: str, path: str, body: bytes, status: int, code: str
) -> None:
    answer = await platform.raw(method, path, body, **client.basic("ann", PASSWORD))
    assert (answer[0], answer[1]["code"]) == (status, code)
    assert answer[1]["detail"]


async def test_package_cannot_be_shared_with_an_unknown_user(platform: Platform) -> None:
    await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    with pytest.raises(NotFound, match="no user 'carl'"):
        await platform.do("ann", lambda packages: packages.share("tool", ["bob", "carl"]))
    assert await names(platform, "bob") == set()


# --- uploads ---


async def announce(platform: Platform, content: bytes, size: int = 0) -> str:
    body = {"name": "tool", "digest": hashlib.sha256(content).hexdigest(), "size": size or len(content)}
    answer = await platform.raw("POST", "/api/v1/packages", msgspec.json.encode(body), **client.basic("ann", PASSWORD))
    assert answer[0] == 202
    return str(answer[1]["token"])


def packed(platform: Platform) -> bytes:
    out = io.BytesIO()
    archive.write(platform.entries(b"z" * 1000), out)
    return out.getvalue()


async def test_upload_ticket_is_valid_once(platform: Platform) -> None:
    content = packed(platform)
    token = client.bearer(await announce(platform, content))
    assert (await platform.raw("PUT", "/api/v1/uploads", content, **token))[0] == 201
    assert (await platform.raw("PUT", "/api/v1/uploads", content, **token))[0] == 401
    assert platform.stored() == {hashlib.sha256(content).hexdigest()}


async def test_digest_alone_does_not_give_an_archive(platform: Platform) -> None:
    contents = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    body = {"name": "mine", "digest": contents.digest, "size": contents.size}
    answer = await platform.raw("POST", "/api/v1/packages", msgspec.json.encode(body), **client.basic("eve", PASSWORD))
    assert (answer[0], bool(answer[1]["token"])) == (202, True)  # eve must show that she has it
    assert await names(platform, "eve") == set()


@pytest.mark.parametrize(
    ("sent", "status"),
    [(b"", 401), (b"short", 401), (b"another of equal size".ljust(3072, b"x"), 400), (b"\x00" * 3072, 400)],
)
async def test_upload_that_was_not_announced_is_refused(platform: Platform, sent: bytes, status: int) -> None:
    content = packed(platform)
    assert len(content) == 3072 + 1024
    token = await announce(platform, content[:3072])
    assert (await platform.raw("PUT", "/api/v1/uploads", sent, **client.bearer(token)))[0] == status
    assert platform.stored() == set()
    assert platform.depot.pending() == []


async def test_malformed_archive_is_refused(platform: Platform) -> None:
    token = await announce(platform, b"no archive")
    status, problem = await platform.raw("PUT", "/api/v1/uploads", b"no archive", **client.bearer(token))
    assert (status, problem["code"]) == (400, "invalid_request")
    assert platform.stored() == set()


async def test_interrupted_upload_leaves_nothing(platform: Platform) -> None:
    content = packed(platform)
    token = await announce(platform, content)

    def half() -> None:
        with socket.create_connection(("127.0.0.1", platform.port)) as connection:
            head = f"PUT /api/v1/uploads HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\n"
            connection.sendall(f"{head}Content-Length: {len(content)}\r\n\r\n".encode() + content[:2000])
            while not platform.stored():
                pass

    await asyncio.wait_for(asyncio.to_thread(half), 20)
    async with asyncio.timeout(20):
        while platform.stored():  # noqa: ASYNC110  # when the server notices the end is its business
            await asyncio.sleep(0.01)
    assert platform.depot.pending() == []


async def test_upload_that_cannot_be_stored_is_unavailable(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Upload, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Upload, "write", fail)
    content = packed(platform)
    token = await announce(platform, content)
    status, problem = await platform.raw("PUT", "/api/v1/uploads", content, **client.bearer(token))
    assert (status, problem["code"]) == (503, "unavailable")
    assert platform.stored() == set()


async def test_large_body_without_a_ticket_is_refused(platform: Platform) -> None:
    def send() -> bytes:
        with socket.create_connection(("127.0.0.1", platform.port), 20) as connection:
            connection.sendall(b"PUT /api/v1/uploads HTTP/1.1\r\nHost: x\r\nContent-Length: 9999999999\r\n\r\n")
            return connection.recv(4096)

    assert (await asyncio.to_thread(send)).startswith(b"HTTP/1.1 413 ")
    assert platform.stored() == set()


async def test_quota_counts_announced_uploads(platform: Platform) -> None:
    await announce(platform, b"a", QUOTA // 2)
    await announce(platform, b"b", QUOTA // 2)
    with pytest.raises(LimitExceeded) as raised:
        await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    assert raised.value.info.fields["limit"] == QUOTA
    await platform.do("bob", lambda packages: packages.push("tool", platform.entries()))


async def test_uploads_at_once_are_limited(platform: Platform) -> None:
    for number in range(4):
        await announce(platform, bytes([number]))
    with pytest.raises(LimitExceeded, match="under way"):
        await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))


# --- downloads by task sets ---


async def test_task_set_fetches_packages_of_its_environments(platform: Platform, tmp_path: Path) -> None:
    contents = await platform.do("ann", lambda packages: packages.push("tool", platform.entries()))
    master = platform.master
    machine, other = Process("m1", "container", "1", capacity=4), Process("m2", "container", "1")
    master.state.processes.put(machine)
    master.state.joined.add("m1")
    fetch = master._fetch_package
    with pytest.raises(NotFound):
        await fetch(machine, FetchPackage(contents.digest))
    master.state.environments.put(Environment("ann/e", ContainerData(), "0" * 32, "m1", packages=[contents.digest]))
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


async def test_interrupted_download_closes_the_file(platform: Platform, failures: list[LogEvent]) -> None:
    path = platform.files / "large"
    with path.open("wb") as file:
        file.truncate(200_000_000)
    token = platform.depot._fetches.issue(path)

    def begin() -> bytes:
        with socket.create_connection(("127.0.0.1", platform.port), 20) as connection:
            connection.sendall(
                f"GET /api/v1/archives HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\n\r\n".encode()
            )
            return connection.recv(4096)

    assert (await asyncio.to_thread(begin)).startswith(b"HTTP/1.1 200 ")
    async with asyncio.timeout(20):
        while str(path) in open_files():  # noqa: ASYNC110  # when the server notices is up to the network
            await asyncio.sleep(0.01)
    assert not failures


async def test_entry_is_on_the_same_port(platform: Platform) -> None:
    def ask() -> int:
        connection = http.client.HTTPConnection("127.0.0.1", platform.port, timeout=20)
        connection.request("GET", "/?userID=ann", headers={"Connection": "close"})
        return connection.getresponse().status

    assert await asyncio.to_thread(ask) == 400


async def test_client_without_a_server() -> None:
    entry = client.EntryClient("http://127.0.0.1:1/", {})
    with pytest.raises(RceError, match="cannot reach"):
        await asyncio.to_thread(entry.json, "GET", "/")
    with pytest.raises(InvalidRequest):
        client.EntryClient("ftp://x/", {})

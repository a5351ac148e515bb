"""The HTTP server of a Master: uploads go to disk, other bodies are limited, paths lead to their parts."""

from __future__ import annotations

import asyncio
import errno
import http.client
import os
import socket

import pytest
from twisted.logger import LogEvent

from master import dashboard
from master.api.site import MAX_BODY
from master.storage.depot import Upload
from rce.api import http as client
from rce.web import requests
from tests.support.master.package_platform import PackagePlatform, announce, packed


def head(method: str, path: str, token: str = "", *, length: int = 0) -> bytes:
    """Return the head of a request with a body of this length."""
    authorization = f"Authorization: Bearer {token}\r\n" if token else ""
    return f"{method} {path} HTTP/1.1\r\nHost: x\r\n{authorization}Content-Length: {length}\r\n\r\n".encode()


def open_files() -> set[str]:
    return {os.path.realpath(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")}


async def status_of(platform: PackagePlatform, method: str, path: str, body: bytes = b"") -> tuple[int, str]:
    """Return the status and the Location of the answer to a request without credentials."""

    def ask() -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", platform.port, timeout=20)
        connection.request(method, path, body, {"Connection": "close", "Accept": "text/html"})
        answer = connection.getresponse()
        connection.close()
        return answer.status, answer.headers.get("location", "")

    return await asyncio.to_thread(ask)


async def test_paths_lead_to_the_parts(platform: PackagePlatform) -> None:
    for path, answer in (
        ("/api/v1/packages", (401, "")),
        ("/api/v1/none", (404, "")),
        ("/healthz", (404, "")),  # this API has no monitoring
        ("/metrics/none", (404, "")),
        (dashboard.PREFIX, (200, "")),
        (dashboard.PREFIX.rstrip("/"), (302, dashboard.PREFIX)),
        ("/", (302, dashboard.PREFIX)),  # a browser
        ("/?userID=ann", (400, "")),  # a robot, which lacks its version
        ("/elsewhere?userID=ann", (400, "")),
    ):
        assert await status_of(platform, "GET", path) == answer, path


async def test_bodies_are_limited(platform: PackagePlatform) -> None:
    assert (await status_of(platform, "POST", "/api/v1/packages", b"x" * MAX_BODY))[0] == 401
    assert (await status_of(platform, "POST", "/api/v1/packages", b"x" * (MAX_BODY + 1)))[0] == 413


async def test_large_body_without_a_ticket_is_refused(platform: PackagePlatform) -> None:
    def send() -> bytes:
        with socket.create_connection(("127.0.0.1", platform.port), 20) as connection:
            connection.sendall(head("PUT", "/api/v1/uploads", length=9_999_999_999))
            return connection.recv(4096)

    assert (await asyncio.to_thread(send)).startswith(b"HTTP/1.1 413 ")
    assert platform.stored() == set()


async def test_interrupted_upload_leaves_nothing(platform: PackagePlatform) -> None:
    content = packed(platform)
    token = await announce(platform, content)
    _, writer = await asyncio.open_connection("127.0.0.1", platform.port)
    writer.write(head("PUT", "/api/v1/uploads", token, length=len(content)) + content[:2000])
    async with asyncio.timeout(20):
        while not platform.stored():  # noqa: ASYNC110  # a file has no event
            await asyncio.sleep(0.001)
        writer.close()
        while platform.stored():  # noqa: ASYNC110  # when the server notices the end is its business
            await asyncio.sleep(0.001)
    assert platform.depot.pending() == []


async def test_upload_that_pauses_too_long_is_broken_off(
    platform: PackagePlatform, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT", 0.05)
    token = await announce(platform, b"x" * 5000)
    reader, writer = await asyncio.open_connection("127.0.0.1", platform.port)
    writer.write(head("PUT", "/api/v1/uploads", token, length=5000) + b"x" * 100)
    assert (await asyncio.wait_for(reader.readline(), 20)).split()[1] == b"408"
    writer.close()
    assert platform.stored() == set()


async def test_upload_that_cannot_be_stored_is_unavailable(
    platform: PackagePlatform, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Upload, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(Upload, "write", fail)
    content = packed(platform)
    token = await announce(platform, content)
    status, problem = await platform.raw("PUT", "/api/v1/uploads", content, client.bearer(token))
    assert (status, problem["code"]) == (503, "unavailable")
    assert platform.stored() == set()


async def test_interrupted_download_closes_the_file(platform: PackagePlatform, failures: list[LogEvent]) -> None:
    path = platform.files / "large"
    with path.open("wb") as file:
        file.truncate(200_000_000)
    token = platform.depot._fetches.issue(path)
    reader, writer = await asyncio.open_connection("127.0.0.1", platform.port)
    writer.write(head("GET", "/api/v1/archives", token))
    assert (await asyncio.wait_for(reader.readline(), 20)).startswith(b"HTTP/1.1 200 ")
    writer.close()
    async with asyncio.timeout(20):
        while str(path) in open_files():  # noqa: ASYNC110  # when the server notices is up to the network
            await asyncio.sleep(0.001)
    assert not failures

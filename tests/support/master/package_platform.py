"""A Master with the packages of its API only, and a small quota for them."""

from __future__ import annotations

import asyncio
import hashlib
import http.client
import io
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple

import argon2
import msgspec
from twisted.internet.base import ReactorBase

from master.api.packages import PackagesApi
from master.api.router import Api
from master.api.site import Site
from master.graph.limits import Policy
from master.service import Master
from master.storage.depot import Depot
from rce.api import http as client
from rce.packages import archive
from rce.packages.client import PackagesClient
from rce.web.server import Endpoint
from tests.support.master.database import open_store
from tests.support.master.served import PASSWORD

QUOTA = 100_000


class PackagePlatform(NamedTuple):
    """A Master with its depot, clients of its users, and a directory of files."""

    master: Master
    depot: Depot
    port: int
    files: Path

    def entry(self, user: str, secret: str = PASSWORD) -> client.EntryClient:
        return client.EntryClient(f"http://127.0.0.1:{self.port}/", client.basic(user, secret))

    async def do(self, user: str, action: Callable[[PackagesClient], Any], secret: str = PASSWORD) -> Any:
        return await asyncio.to_thread(action, PackagesClient(self.entry(user, secret)))

    async def raw(
        self, method: str, path: str, body: bytes = b"", headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Return the status and the body of the answer to one request."""

        def ask() -> tuple[int, dict[str, Any]]:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
            kind = {"Content-Type": "application/json"}
            connection.request(method, path, body, {"Connection": "close"} | kind | (headers or {}))
            response = connection.getresponse()
            answer = response.status, json.loads(response.read() or b"{}")
            connection.close()
            return answer

        return await asyncio.to_thread(ask)

    def stored(self) -> set[str]:
        """Return the names of files in the depot, also of unfinished ones."""
        return {path.name for path in (self.files / "depot").rglob("*") if path.is_file()}

    def entries(self, content: bytes = b"x") -> list[archive.Entry]:
        source = self.files / "file"
        source.write_bytes(content)
        return [archive.Entry("p/package.xml", source, False), archive.Entry("p/talk.py", source, False)]


@asynccontextmanager
async def serve_packages(reactor: ReactorBase, files: Path) -> AsyncIterator[PackagePlatform]:
    """Serve ann, bob and eve; `reactor` is the fixture, which checks that nothing is left behind."""
    store = await open_store()
    depot = Depot(files / "depot")
    master = Master(store, 10, Policy(package_bytes=QUOTA), depot=depot)
    master.users.passwords.hasher = argon2.PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)
    for user in ("ann", "bob", "eve"):
        await master.users.add(user, PASSWORD)
    await master.start()
    api = Api(master.users, master.audit)
    PackagesApi(master, depot).add_to(api)
    site = Site(master.state, api, depot)
    _, port = await site.start(Endpoint("127.0.0.1", 0))
    master.entry = ("http", port)
    yield PackagePlatform(master, depot, port, files)
    await site.stop()
    await master.stop()
    await store.close()


async def announce(platform: PackagePlatform, content: bytes, size: int = 0) -> str:
    """Announce an upload of ann and return its ticket."""
    body = {"name": "tool", "digest": hashlib.sha256(content).hexdigest(), "size": size or len(content)}
    answer = await platform.raw("POST", "/api/v1/packages", msgspec.json.encode(body), client.basic("ann", PASSWORD))
    assert answer[0] == 202
    return str(answer[1]["token"])


def packed(platform: PackagePlatform) -> bytes:
    """Return an archive that is good."""
    out = io.BytesIO()
    archive.write(platform.entries(b"z" * 1000), out)
    return out.getvalue()

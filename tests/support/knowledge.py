"""Knowledge service in this process with a fake Master, and ontologies."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import aiohttp
import pytest

from rce.api.knowledge import PREFIX, NewEntry
from rce.control.calls.call import Call, Nothing
from rce.control.calls.knowledge import ReportChanges
from rce.control.calls.services import Authenticate, Identity, RecordAction
from rce.errors import Forbidden, RceError, Unauthorized
from rce.knowledge import server
from rce.knowledge.messages import Evaluate, Read, Reply
from rce.knowledge.queries import QueryLimits
from rce.knowledge.repository import RepositoryLimits
from rce.knowledge.server import KnowledgeLimits, KnowledgeService
from rce.knowledge.texts import Texts
from rce.knowledge.worker import Worker
from tests.support.paths import DATA

KEYS = {"rce_ann": "ann", "rce_bob": "bob", "rce_root": "root", "rce_eve": "eve"}
LIMITS = KnowledgeLimits(
    RepositoryLimits(file=1_000_000, user=3_000_000, spare=0), QueryLimits(seconds=30, memory=512 * 1024**2, rows=100)
)
KITCHEN = "http://example.org/kitchen.owl#"
CUP = f"""@prefix k: <{KITCHEN}> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
k:Cup rdfs:subClassOf k:Vessel . k:Vessel rdfs:subClassOf k:Thing .
k:cup1 a k:Cup ; rdfs:label "the blue cup" ; k:height 0.1 .
"""
BED = f"""<?xml version="1.0"?>
<!DOCTYPE rdf:RDF [ <!ENTITY k '{KITCHEN}'> ]>
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#" xmlns:k="{KITCHEN}">
  <k:Bed rdf:about="&k;bed1"/>
</rdf:RDF>
"""


def ontologies() -> Path:
    """Return the directory of real ontologies, or skip the test."""
    if not (DATA / "owl").is_dir():
        pytest.skip(f"needs owl in {DATA}, or RCE_DATA")
    return DATA / "owl"


class FakeMaster:
    """Master with users known by their keys: root may do everything, eve may only read."""

    def __init__(self) -> None:
        self.failure: RceError | None = None
        self.unbounded = {"root"}  # users who may do everything
        self.calls: list[Call[Any]] = []

    @property
    def connected(self) -> bool:
        return self.failure is None

    async def call(self, call: Call[Any], wait: float = 10.0) -> Any:
        self.calls.append(call)
        if self.failure is not None:
            raise self.failure
        if isinstance(call, RecordAction | ReportChanges):
            return Nothing()
        if isinstance(call, Authenticate) and call.secret in KEYS:
            name = KEYS[call.secret]
            if name == "eve" and call.operation != "knowledge.read":
                raise Forbidden("the role viewer may not")
            return Identity(name, "user", reach="all" if name in self.unbounded else "own")
        raise Unauthorized("user or password is wrong")

    def recorded(self) -> list[tuple[str, str, str]]:
        """Return action, object and result of each record of the audit log."""
        return [(each.action, each.object, each.result) for each in self.calls if isinstance(each, RecordAction)]


class SharedWorker(Worker):
    """Process that reads the texts of one service after another, since each start takes 0.2 s."""

    _busy = False

    async def ask(self, work: Read | Evaluate) -> Reply:
        self._busy = True
        try:
            return await super().ask(work)
        finally:
            self._busy = False

    async def stop(self) -> None:
        """Kill the process if it works: what it would reply next belongs to no one."""
        if self._busy:
            await super().stop()

    async def close(self) -> None:
        await super().stop()


class Service:
    """Knowledge service on a free port, with a client for each user; `worker` reads its texts, else one of its own."""

    def __init__(
        self, directory: Path, limits: KnowledgeLimits = LIMITS, anonymous: bool = False, worker: Worker | None = None
    ) -> None:
        self.directory = directory
        self.worker = worker
        self.limits = limits
        self.anonymous = anonymous
        self.master = FakeMaster()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start(self) -> None:
        with pytest.MonkeyPatch.context() as patch:  # no test waits for what a subscriber may still do
            patch.setattr(server, "SHUTDOWN_TIMEOUT", 0.05)
            patch.setattr(server, "Texts", lambda: Texts(lambda: self.worker or Worker()))
            await self._start()

    async def _start(self) -> None:
        self.service = KnowledgeService(self.directory, lambda: self.master, self.limits, self.anonymous)
        port = await self.service.start("127.0.0.1", 0)
        self.root = f"http://127.0.0.1:{port}"
        self.url = self.root + PREFIX
        self.session = aiohttp.ClientSession()

    async def stop(self) -> None:
        await self.session.close()
        await self.service.stop()

    async def request(self, method: str, path: str, user: str = "ann", **more: Any) -> aiohttp.ClientResponse:
        """Send a request and return the answer with its body; `path` may be a URL."""
        headers = ({"Authorization": f"Bearer rce_{user}"} if user else {}) | more.pop("headers", {})
        url = path if path.startswith("http") else self.url + path
        answer = await self.session.request(method, url, headers=headers, **more)
        await answer.read()
        return answer

    async def json(self, method: str, path: str, user: str = "ann", **more: Any) -> Any:
        """Send a request that succeeds and return the JSON of its answer."""
        answer = await self.request(method, path, user, **more)
        assert answer.status < 300, await answer.text()
        return await answer.json()

    async def add(self, user: str = "ann", **fields: Any) -> Any:
        """Add an object, or what the fields say."""
        body = {"kind": "object", "class": "cup", "id": "blue", "owl": CUP, **fields}
        return await self.json("POST", "/entries", user, json=body)

    async def query(self, query: str, user: str = "ann", **more: Any) -> Any:
        """Answer a query."""
        return await self.json("POST", "/query", user, json={"query": query, **more})


def new_entry(**fields: Any) -> NewEntry:
    """Return an object to add, or what the fields say."""
    given: dict[str, Any] = {"kind": "object", "cls": "cup", "id": "blue", "owl": CUP}
    return NewEntry(**(given | fields))

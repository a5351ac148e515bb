"""Map service in this process, with a fake Master and a fake job runner that a test controls."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import aiohttp

from rce.control.calls.call import Call, Nothing
from rce.control.calls.services import (
    Authenticate,
    CreateGrant,
    Grant,
    Identity,
    IssueKey,
    RecordAction,
    RevokeGrant,
    TemporaryKey,
)
from rce.errors import RceError, Unauthorized
from rce.mapservice.job_program import Report, Task
from rce.mapservice.jobs import JobLimits
from rce.mapservice.server import MapService, MapServiceLimits
from rce.mapservice.uploads import UploadLimits

SCANS = 12
KEYS = {"rce_ann": "ann", "rce_bob": "bob"}
FLASER = "FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 {0}.0 host {0}.0\n"
LOG = "".join(FLASER.format(second) for second in range(1, 21)).encode()


class FakeMaster:
    """Master with two users, known by their keys; with `failure`, every call raises it."""

    def __init__(self) -> None:
        self.failure: RceError | None = None
        self.calls: list[Call[Any]] = []
        self.grants: dict[str, str] = {}

    @property
    def connected(self) -> bool:
        return self.failure is None

    async def call(self, call: Call[Any], wait: float = 10.0) -> Any:
        self.calls.append(call)
        if self.failure is not None:
            raise self.failure
        match call:
            case Authenticate(user, secret, _, _) if KEYS.get(secret, "") and user in ("", KEYS[secret]):
                return Identity(KEYS[secret], "robot")
            case RecordAction():
                return Nothing()
            case CreateGrant(user, _):
                name = f"grant {len(self.calls)}"
                self.grants[name] = user
                return Grant(name)
            case IssueKey(grant, _) if grant in self.grants:
                return TemporaryKey(self.grants[grant], "rce_lent_1")
            case RevokeGrant(grant):
                self.grants.pop(grant, None)
                return Nothing()
        raise Unauthorized("user or password is wrong")


class FakeRunner:
    """Job runner whose jobs run until the test ends them."""

    def __init__(self) -> None:
        self.tasks: list[Task] = []
        self.cleaned: list[Task] = []
        self.inspect_error: RceError | None = None
        self._ends: dict[str, asyncio.Future[None]] = {}
        self._on_report: dict[str, Callable[[Report], None]] = {}

    async def inspect(self, task: Task) -> int | None:
        if self.inspect_error is not None:
            raise self.inspect_error
        return SCANS

    async def build(self, task: Task, log_file: Path, on_report: Callable[[Report], None]) -> None:
        self.tasks.append(task)
        self._ends[task.name] = asyncio.get_running_loop().create_future()
        self._on_report[task.name] = on_report
        log_file.write_text("a log\n")  # noqa: ASYNC240
        await self._ends[task.name]
        (Path(task.out) / "map.png").write_bytes(b"a picture")

    async def clean(self, task: Task) -> None:
        self.cleaned.append(task)

    def task(self, job: str) -> Task:
        """Return the task of the latest attempt at a job."""
        return next(task for task in reversed(self.tasks) if job in task.name)

    def report(self, job: str, report: Report) -> None:
        self._on_report[self.task(job).name](report)

    def finish(self, job: str, error: BaseException | None = None) -> None:
        end = self._ends[self.task(job).name]
        if error is None:
            end.set_result(None)
        else:
            end.set_exception(error)

    @property
    def running(self) -> list[str]:
        return [name for name, end in self._ends.items() if not end.done()]


LIMITS = MapServiceLimits(UploadLimits(10_000_000, 20_000_000, 0, 1000.0), JobLimits(2, 1, 3, 1000.0, 100.0))


class Service:
    """Map service on a free port, with a client for each user."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.master = FakeMaster()
        self.runner = FakeRunner()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.stop()

    async def start(self) -> None:
        self.service = MapService(self.directory, lambda: self.master, self.runner, LIMITS, "http://entry/")
        self.service.jobs.start()
        port = await self.service.start("127.0.0.1", 0)
        self.url = f"http://127.0.0.1:{port}/map-service"
        self.session = aiohttp.ClientSession()

    async def stop(self) -> None:
        await self.session.close()
        await self.service.stop()

    async def request(self, method: str, path: str, user: str = "ann", **more: Any) -> aiohttp.ClientResponse:
        """Send a request and return the answer with its body; `path` may be a URL."""
        headers = {"Authorization": f"Bearer rce_{user}"} | more.pop("headers", {})
        url = path if path.startswith("http") else self.url + path
        answer = await self.session.request(method, url, headers=headers, **more)
        await answer.read()
        return answer

    async def upload(self, content: bytes = LOG, name: str = "a.log", user: str = "ann") -> str:
        headers = {"Content-Type": "application/offset+octet-stream"}
        answer = await self.request("POST", f"/uploads?filename={name}", user, data=content, headers=headers)
        assert answer.status == 201, await answer.text()
        return str((await answer.json())["id"])

    async def submit(self, user: str = "ann", **options: Any) -> str:
        request = {"uploads": [await self.upload(user=user)], "options": options}
        answer = await self.request("POST", "/jobs", user, json=request)
        assert answer.status == 201, await answer.text()
        return str((await answer.json())["id"])

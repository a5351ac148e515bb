"""Console at a platform that a test plays: requests are recorded and answered with prepared values."""

from __future__ import annotations

import asyncio
import io
import shlex
import sys
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar, cast

import msgspec
import pytest

from rce.api import views
from rce.api.client import ApiClient, ServerEvent
from rce.cli import execute
from rce.cli.contexts import Access
from rce.cli.session import ConsoleSession
from rce.protocol.messages import ContainerData, Delivery, Qos

T = TypeVar("T")
ACCESS = Access("http://127.0.0.1:1/", "ann", "secret", None)


class Request(NamedTuple):
    """Request, as its method and path, the query without empty values, and the body."""

    line: str
    query: dict[str, object]
    body: Any = None


class FakeApi:
    """Platform's API with an answer for each request, in order; an exception as answer is raised."""

    def __init__(self, *answers: object) -> None:
        self.requests: list[Request] = []
        self._answers = list(answers)

    def _answer(self, method: str, parts: tuple[str, ...], query: dict[str, object], body: object = None) -> Any:
        given = {name: value for name, value in query.items() if value not in ("", None)}
        self.requests.append(Request(f"{method} {'/'.join(parts)}", given, msgspec.to_builtins(body)))
        answer = self._answers.pop(0) if self._answers else None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def get(self, kind: type[T], *parts: str, **query: object) -> T:
        return msgspec.convert(msgspec.to_builtins(self._answer("GET", parts, query)), kind)

    def items(self, kind: type[T], *parts: str, **query: object) -> Iterator[T]:
        listed = msgspec.to_builtins(self._answer("GET", parts, query))
        return iter(msgspec.convert(listed, list[kind]))  # type: ignore[valid-type]

    def post(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        return cast(T, self._answer("POST", parts, query, body))

    def put(self, *parts: str, body: object = None, **query: object) -> None:
        self._answer("PUT", parts, query, body)

    def patch(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        return cast(T, self._answer("PATCH", parts, query, body))

    def delete(self, *parts: str, **query: object) -> None:
        self._answer("DELETE", parts, query)

    def follow(self, *parts: str, **query: object) -> Iterator[ServerEvent]:
        for each in self._answer("FOLLOW", parts, query):
            yield ServerEvent("message", msgspec.json.encode(each).decode())


class Console:
    """Console of the user ann, at a platform that gives these answers."""

    def __init__(self, *answers: object) -> None:
        self.api = FakeApi(*answers)
        self.session = ConsoleSession()
        self.session.__dict__.update(access=ACCESS, api=cast(ApiClient, self.api))

    def run(self, line: str) -> int:
        """Run a line of the console and return its exit status."""
        return execute.run(shlex.split(line), self.session)

    def request(self, line: str) -> Request:
        """Run a line that must succeed and make one request, and return the request."""
        assert self.run(line) == execute.SUCCESS
        (made,) = self.api.requests
        return made


async def rce(*words: str) -> int:
    """Run a command line of a shell in a thread and return its exit status."""
    return await asyncio.to_thread(execute.run, words)


async def login(url: str, user: str, context: str) -> None:
    """Sign in with the password in RCE_PASSWORD; the new context becomes the current one."""
    assert await rce("login", url, "--user", user, "--context", context) == execute.SUCCESS


class Terminal(io.StringIO):
    """Standard stream that is a terminal."""

    def isatty(self) -> bool:
        return True


def open_terminal(monkeypatch: pytest.MonkeyPatch, columns: int) -> Terminal:
    """Return a terminal without bold letters, which is standard output until the end of the test."""
    terminal = Terminal()
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(sys, "stdout", terminal)
    return terminal


def environment(tag: str = "brain", **changes: Any) -> views.EnvironmentView:
    """Return a ready environment of ann."""
    usual: dict[str, Any] = {
        "user": "ann",
        "containerTag": tag,
        "state": "ready",
        "machine": "machine-1",
        "containerData": ContainerData(cpu=2, memory=3 * 2**29),
        "address": "",
        "egress": "none",
        "packages": [],
        "nodes": 3,
        "parameters": 1,
        "interfaces": 5,
    }
    return views.EnvironmentView(**usual | changes)


def node(tag: str = "echo", **changes: Any) -> views.NodeView:
    """Return a running node of ann's environment brain."""
    usual: dict[str, Any] = {
        "user": "ann",
        "containerTag": "brain",
        "nodeTag": tag,
        "state": "running",
        "pkg": "rce_demo",
        "exe": "echo",
        "args": "",
        "name": "",
        "namespace": "",
    }
    return views.NodeView(**usual | changes)


def interface(endpoint: str = "brain", tag: str = "pose", **changes: Any) -> views.InterfaceView:
    """Return a ready interface of ann."""
    usual: dict[str, Any] = {
        "user": "ann",
        "endpointTag": endpoint,
        "interfaceTag": tag,
        "state": "ready",
        "interfaceType": "PublisherInterface",
        "className": "geometry_msgs/Pose2D",
        "addr": "/pose",
        "qos": Qos(),
        "format": "png",
        "delivery": Delivery(),
        "codec": "",
        "connections": 1,
    }
    return views.InterfaceView(**usual | changes)


def machine(name: str = "machine-1", **changes: Any) -> views.MachineView:
    """Return a task set that has joined."""
    usual: dict[str, Any] = {
        "name": name,
        "role": "container",
        "state": "joined",
        "host": "4f1d",
        "url": "",
        "slots": 10,
        "used": 3,
        "gpus": 0,
        "gpusUsed": 0,
        "features": [],
        "environments": 3,
        "robots": 0,
    }
    return views.MachineView(**usual | changes)

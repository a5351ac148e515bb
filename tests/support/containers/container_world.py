"""World of an engine that runs containers, seen through a Docker daemon."""

from __future__ import annotations

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import docker
from twisted.internet.base import ReactorBase

from containers.docker.setup import Setup
from containers.engine import Engine, EnvironmentEnded
from tests.support.containers.engine_contract import World

COMMAND = ["/stand-in"]
IMAGE = "rce-test/stand-in:latest"


class ContainerWorld(World):
    def __init__(self, directory: Path, api: docker.APIClient, reactor: ReactorBase) -> None:
        self.directory = directory
        self.api = api
        self._reactor = reactor

    def setup(self, *behaviour: str, image: str = "", master: str = "tcp:127.0.0.1:1") -> Setup:
        return Setup(
            reactor=self._reactor,
            platform="machine",
            directory=self.directory,
            master=master,
            image=image or IMAGE,
            settings={"typesupport": "/types"},
            command=[*COMMAND, *behaviour],
        )

    def break_start(self, engine: Engine) -> None:
        engine._setup = replace(engine._setup, command=["/nonexistent/program"])  # type: ignore[attr-defined]

    async def end(self, name: str) -> None:
        container = self._container(name)
        async with asyncio.timeout(60):
            while b"ready" not in await asyncio.to_thread(self.api.logs, container):  # noqa: ASYNC110
                await asyncio.sleep(0.01)  # the kernel drops signals that the first process does not handle yet
        await asyncio.to_thread(self.api.kill, container, "SIGUSR1")
        await asyncio.to_thread(self.api.wait, container)

    @property
    def own_filter(self) -> dict[str, list[str]]:
        return {"label": [f"rce.directory={self.directory}", "rce.run"]}

    def containers(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.api.containers(all=True, filters=self.own_filter)
        return found

    def _container(self, name: str) -> str:
        (container,) = [each["Id"] for each in self.containers() if each["Labels"]["rce.environment"] == name]
        return str(container)

    @abstractmethod
    def engine(self, ended: Callable[[EnvironmentEnded], None], *behaviour: str) -> Engine:
        """Return a new engine whose environments behave so; see `World.engine` and stand_in.c."""

    @abstractmethod
    def remains(self) -> set[str]: ...

    def alive(self) -> dict[str, str]:
        labels = [each["Labels"] for each in self.containers() if each["State"] == "running"]
        return {each["rce.environment"]: each["rce.run"] for each in labels}

    def inspect(self, name: str) -> dict[str, Any]:
        seen: dict[str, Any] = self.api.inspect_container(self._container(name))
        return seen

"""The engine `docker` with a real daemon: the contract, and the walls around an environment."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from engine_contract import CAPACITY, FEATURES, Endings, EngineContract, World, spec
from twisted.internet.base import ReactorBase

docker = pytest.importorskip("docker", reason="needs docker-py: pip install 'rce[docker]'")

from containers.docker import DockerEngine
from containers.docker_options import MB
from containers.engine import Ended, Engine, Life
from rce.calls import EnvironmentSpec
from rce.errors import InvalidRequest, LimitExceeded, StartFailed, Unavailable
from rce.messages import ContainerData

COMMAND = ["/stand-in"]


class DockerWorld(World):
    def __init__(self, directory: Path, image: str, reactor: ReactorBase) -> None:
        self.directory = directory
        self.image = image
        self.api = docker.APIClient(**docker.utils.kwargs_from_env(), version="auto")
        self._reactor = reactor

    def engine(
        self, ended: Callable[[Ended], None], *behaviour: str, image: str = "", master: str = ""
    ) -> DockerEngine:
        return DockerEngine(
            CAPACITY,
            FEATURES,
            ended,
            reactor=self._reactor,
            platform="machine",
            directory=self.directory,
            master=master or "tcp:127.0.0.1:1",
            image=image or self.image,
            settings={"typesupport": "/types"},
            command=[*COMMAND, *behaviour],
        )

    def break_start(self, engine: Engine) -> None:
        assert isinstance(engine, DockerEngine)
        engine._command = ["/nonexistent/program"]

    async def end(self, name: str) -> None:
        (container,) = [each["Id"] for each in self.containers() if each["Labels"]["rce.environment"] == name]
        await asyncio.to_thread(self.api.kill, container, "SIGUSR1")
        await asyncio.to_thread(self.api.wait, container)

    def containers(self) -> list[dict[str, Any]]:
        label = f"rce.directory={self.directory}"
        found: list[dict[str, Any]] = self.api.containers(all=True, filters={"label": label})
        return found

    def there(self) -> set[str]:
        """A socket's directory counts as its user's."""
        root, sockets = self.directory / "environments", self.directory / "sockets"
        tags = {str(path.relative_to(root)) for path in root.glob("*/*")}
        users = {path.name for path in [*root.glob("*"), *sockets.glob("*")]}
        named = {each["Labels"]["rce.environment"] for each in self.containers()}
        return tags | named | (users - {tag.partition("/")[0] for tag in tags})

    def alive(self) -> dict[str, str]:
        labels = [each["Labels"] for each in self.containers() if each["State"] == "running"]
        return {each["rce.environment"]: each["rce.run"] for each in labels}

    def inspect(self, name: str) -> dict[str, Any]:
        (container,) = [each["Id"] for each in self.containers() if each["Labels"]["rce.environment"] == name]
        seen: dict[str, Any] = self.api.inspect_container(container)
        return seen


@pytest.fixture
def world(tmp_path: Path, stand_in_image: str, reactor: ReactorBase) -> Iterator[DockerWorld]:
    world = DockerWorld(tmp_path, stand_in_image, reactor)
    yield world
    world.api.close()


@pytest.fixture
def endings() -> Endings:
    return Endings()


class TestDockerEngine(EngineContract):
    @pytest.fixture
    def world(self, tmp_path: Path, stand_in_image: str, reactor: ReactorBase) -> Iterator[DockerWorld]:
        world = DockerWorld(tmp_path, stand_in_image, reactor)
        yield world
        world.api.close()

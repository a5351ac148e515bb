"""The outside of the engine `docker`: a daemon, and the directory of a task set."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import docker
from container_world import ContainerWorld
from engine_contract import CAPACITY, FEATURES
from twisted.internet.base import ReactorBase

from containers.docker import DockerEngine
from containers.engine import Ended


class DockerWorld(ContainerWorld):
    def __init__(self, directory: Path, image: str, reactor: ReactorBase) -> None:
        api = docker.APIClient(**docker.utils.kwargs_from_env(), version="auto")
        super().__init__(directory, api, reactor)
        self.image = image

    def engine(
        self,
        ended: Callable[[Ended], None],
        *behaviour: str,
        image: str = "",
        master: str = "tcp:127.0.0.1:1",
        gpus: int = 0,
    ) -> DockerEngine:
        setup = self.setup(*behaviour, image=image or self.image, master=master)
        return DockerEngine(CAPACITY, FEATURES, ended, setup, gpus=gpus)

    def there(self) -> set[str]:
        """A socket's directory counts as its user's."""
        root, sockets = self.directory / "environments", self.directory / "sockets"
        tags = {str(path.relative_to(root)) for path in root.glob("*/*")}
        users = {path.name for path in [*root.glob("*"), *sockets.glob("*")]}
        named = {each["Labels"]["rce.environment"] for each in self.containers()}
        return tags | named | (users - {tag.partition("/")[0] for tag in tags})

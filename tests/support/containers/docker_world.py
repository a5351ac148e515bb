"""World of the engine `docker`: a daemon, and the directory of a task set."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import docker
from twisted.internet.base import ReactorBase

from containers.docker.engine import DockerEngine
from containers.engine import EnvironmentEnded
from containers.recordings.receiver import RecordingReceiver
from tests.support.containers.container_world import ContainerWorld
from tests.support.containers.engine_contract import CAPACITY, FEATURES


class DockerWorld(ContainerWorld):
    def __init__(self, directory: Path, image: str, reactor: ReactorBase) -> None:
        api = docker.APIClient(**docker.utils.kwargs_from_env(), version="auto")
        super().__init__(directory, api, reactor)
        self.image = image

    def engine(
        self,
        ended: Callable[[EnvironmentEnded], None],
        *behaviour: str,
        image: str = "",
        master: str = "tcp:127.0.0.1:1",
        gpus: int = 0,
        recordings: RecordingReceiver | None = None,
    ) -> DockerEngine:
        setup = self.setup(*behaviour, image=image or self.image, master=master)
        return DockerEngine(CAPACITY, FEATURES, ended, setup, gpus=gpus, recordings=recordings)

    def remains(self) -> set[str]:
        """Return the names of environments; a directory without an environment counts under its user's name."""
        root, sockets = self.directory / "environments", self.directory / "sockets"
        tags = {str(path.relative_to(root)) for path in root.glob("*/*")}
        users = {path.name for path in [*root.glob("*"), *sockets.glob("*")]}
        named = {each["Labels"]["rce.environment"] for each in self.containers()}
        return tags | named | (users - {tag.partition("/")[0] for tag in tags})

"""What an agent asks of the Docker daemon of its node, off the event loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from docker.errors import APIError, NotFound
from msgspec import Struct

from containers.docker_daemon import CONFLICT, RUN, VERSION, Daemon
from containers.docker_events import Event, Events
from containers.docker_networks import ENVIRONMENT
from rce import __version__

EVENTS = {
    "type": ["container", "image"],
    "event": ["start", "die", "destroy", "tag", "untag", "load", "delete", "import"],
}


class Task(Struct, frozen=True):
    """The container of an environment; neither `running` nor `ended` while it is being made."""

    name: str
    run: str
    running: bool
    ended: bool


class NodeDaemon(Daemon):
    """The containers and volumes with the task set's labels."""

    async def follow(self, happened: Callable[[Event], None], taken_up: Callable[[], None]) -> str:
        """Find the daemon and follow what happens to its containers and images; returns the node's address."""
        await self.reach()
        info = await self._call(self._api.info)
        self._events = Events(self._api, EVENTS, happened, taken_up)
        self._events.start()
        return str(info["Swarm"]["NodeAddr"])

    async def tasks(self) -> list[Task]:
        """All containers of environments here."""
        return await self._call(self._containers)

    async def images(self) -> dict[str, str]:
        """Id of each image for this version by tag: the endpoint of another would not be let in."""
        found = await self._call(lambda: self._api.images(filters={"label": f"{VERSION}={__version__}"}))
        return {tag: each["Id"] for each in found for tag in each["RepoTags"] or []}

    async def volume(self, name: str) -> Path:
        """Where a volume is on the host. NotFound."""
        found = await self._call(lambda: self._api.inspect_volume(name))
        return Path(found["Mountpoint"])

    async def sweep(self, runs: set[str]) -> None:
        """Remove the volumes of all environments but these; of users without an environment too."""
        await self._call(lambda: self._sweep(runs))

    # --- in threads ---------------------------------------------------------------------------------------------------

    def _containers(self) -> list[Task]:
        return [
            Task(
                each["Labels"][ENVIRONMENT],
                each["Labels"][RUN],
                running=each["State"] == "running",
                ended=each["State"] in ("exited", "dead"),
            )
            for each in self._api.containers(all=True, filters={"label": [*self._filter, RUN]})
        ]

    def _sweep(self, runs: set[str]) -> None:
        found: list[dict[str, Any]] = self._api.volumes(filters={"label": self._filter})["Volumes"] or []
        for volume in found:
            if volume["Labels"].get(RUN) not in runs:
                self._remove_volume(volume["Name"])

    def _remove_volume(self, name: str) -> None:
        try:
            self._api.remove_volume(name)
        except NotFound:
            return
        except APIError as error:
            if error.status_code != CONFLICT:  # in use: it is its user's, who has another environment here
                raise

"""What an agent asks of the Docker daemon of its node, off the event loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
from docker.errors import APIError, NotFound
from docker.types import Mount
from msgspec import Struct

from containers.docker_api import said as said_by
from containers.docker_daemon import CONFLICT, RUN, VERSION, Daemon
from containers.docker_events import Event, Events
from containers.docker_networks import ENVIRONMENT
from containers.hands import Work
from containers.swarm_spec import AGENT, DOCKER_SOCKET, SPEC
from rce import __version__
from rce.calls.agents import HaveImage
from rce.calls.environments import EnvironmentSpec
from rce.errors import ErrorInfo, RceError, StartFailed

RIGHTS = ["SYS_ADMIN", "SYS_PTRACE", "NET_ADMIN"]  # to mount, to enter another container, to shape its networks
HANDS = ["python3", "-P", "-m", "containers.hands"]

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
    spec: EnvironmentSpec


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

    async def make_volume(self, name: str, task: Task) -> Path:
        """A volume that goes with an environment; returns where it is on the host."""
        labels = {**self._labels, ENVIRONMENT: task.name, RUN: task.run}
        found = await self._call(lambda: self._api.create_volume(name, labels=labels))
        return Path(found["Mountpoint"])

    async def settle(self, run: str, network: str, address: str) -> None:
        """Give a container its own address in the network of its group, in the place of the one that Swarm chose."""
        await self._call(lambda: self._settle(run, network, address))

    async def join_network(self, run: str, network: str, address: str) -> None:
        """Let a container into a further network, unless it is in it."""
        await self._call(lambda: self._join_network(run, network, address))

    async def hosts_file(self, run: str) -> Path:
        """Where the file of names of a container is. NotFound."""
        found = await self._call(lambda: self._api.inspect_container(self._id(run)))
        return Path(found["HostsPath"])

    async def lend_hands(self, work: Work) -> None:
        """Have something done for which an agent's own container has not the rights. What `work` fails with."""
        status, output = await self._call(lambda: self._lend_hands(work))
        if status:
            lines = output.splitlines() or ["nothing was said"]
            try:
                raise RceError.from_info(msgspec.json.decode(lines[-1], type=ErrorInfo))
            except msgspec.DecodeError:
                raise StartFailed(f"its limits cannot be set: {lines[-1]}") from None

    async def pull(self, call: HaveImage) -> None:
        """Take an image from a registry. StartFailed with what Docker says."""
        await self._call(lambda: self._pull(call))

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
                spec=msgspec.json.decode(each["Labels"][SPEC], type=EnvironmentSpec),
            )
            for each in self._api.containers(all=True, filters={"label": [*self._filter, RUN, SPEC]})
        ]

    def _settle(self, run: str, network: str, address: str) -> None:
        found = self._api.inspect_container(self._id(run))
        present = found["NetworkSettings"]["Networks"].get(network)
        if present is not None and present["IPAddress"] == address:
            return
        if present is not None:
            self._api.disconnect_container_from_network(found["Id"], network)
        self._api.connect_container_to_network(found["Id"], network, ipv4_address=address)

    def _join_network(self, run: str, network: str, address: str) -> None:
        found = self._api.inspect_container(self._id(run))
        if network not in found["NetworkSettings"]["Networks"]:
            self._api.connect_container_to_network(found["Id"], network, ipv4_address=address)

    def _pull(self, call: HaveImage) -> None:
        repository, _, digest = call.source.partition("@")
        identity = {"username": call.user, "password": call.secret}
        try:
            for said in self._api.pull(repository, digest, stream=True, decode=True, auth_config=identity):
                if "error" in said:
                    raise StartFailed(f"image {call.tag} does not come: {said['error']}")
            name, _, tag = call.tag.rpartition(":")
            self._api.tag(call.source, name, tag)
        except APIError as error:
            raise StartFailed(f"image {call.tag} does not come: {said_by(error)}") from None

    def _lend_hands(self, work: Work) -> tuple[int, str]:
        (own,) = self._api.containers(filters={"label": [*self._filter, AGENT]})
        seen = self._api.inspect_container(own["Id"])
        mounts = [
            Mount(each["Target"], each["Source"], type="bind", read_only=each.get("ReadOnly", False))
            for each in seen["HostConfig"]["Mounts"]
            if each["Type"] == "bind" and each["Source"] != DOCKER_SOCKET
        ]
        mounts += [Mount(path, path, type="bind") for path in ("/dev", "/sys/fs/cgroup")]
        made = self._api.create_container(
            seen["Image"],
            HANDS,
            user="0:0",
            environment={"RCE_WORK": msgspec.json.encode(work).decode()},
            labels=self._labels,
            host_config=self._api.create_host_config(
                cap_add=RIGHTS,
                device_cgroup_rules=["b *:* rwm", "c *:* rwm"],  # loop devices, also such as are only being made
                security_opt=["apparmor=unconfined", "seccomp=unconfined", "label=disable"],
                pid_mode="host",
                network_mode="host",
                cgroupns="host",
                mounts=mounts,
            ),
        )
        try:
            self._api.start(made["Id"])
            status: int = self._api.wait(made["Id"])["StatusCode"]
            output: bytes = self._api.logs(made["Id"])
        finally:
            self._api.remove_container(made["Id"], force=True)
        return status, output.decode(errors="replace")

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

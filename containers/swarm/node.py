"""Access of an agent to the Docker daemon of its node, off the event loop."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
from docker.errors import APIError, NotFound
from docker.types import Mount
from msgspec import Struct

from containers.agents.outside_limits import LimitRequest
from containers.docker.api import DOCKER_SOCKET, explanation
from containers.docker.daemon import CONFLICT, RUN, VERSION, Daemon
from containers.docker.events import Event, Events
from containers.docker.networks import ENVIRONMENT
from containers.swarm.privileged import COMMAND, REQUEST_VARIABLE
from containers.swarm.spec import AGENT, SPEC
from rce import __version__
from rce.control.calls.agents import PullImage
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import MALFORMED, ErrorInfo, RceError, StartFailed
from rce.protocol.slots import MB

# To mount disks, to enter other containers, and to limit the bandwidth of their networks.
PRIVILEGED_CAPABILITIES = ["SYS_ADMIN", "SYS_PTRACE", "NET_ADMIN"]
PRIVILEGED_MEMORY, PRIVILEGED_PROCESSES = 512 * MB, 64
EVENTS = {
    "type": ["container", "image"],
    "event": ["start", "die", "destroy", "tag", "untag", "load", "delete", "import"],
}


class Task(Struct, frozen=True):
    """Container of an environment; neither `running` nor `ended` while it is being created."""

    name: str
    run: str
    running: bool
    ended: bool
    spec: EnvironmentSpec


class NodeDaemon(Daemon):
    """Containers and volumes of the task set on this node."""

    async def follow(self, on_event: Callable[[Event], None], on_resumed: Callable[[], None]) -> str:
        """Connect to the daemon and follow the events of containers and images; return the node's address."""
        await self.connect_api()
        info = await self._call(self._api.info)
        self._events = Events(self._api, EVENTS, on_event, on_resumed)
        self._events.start()
        return str(info["Swarm"]["NodeAddr"])

    async def tasks(self) -> list[Task]:
        """Return the containers of environments on this node."""
        return await self._call(self._containers)

    async def images(self) -> dict[str, str]:
        """Return the ids of images by tag; only images for this version, as the Master admits no other endpoints."""
        found = await self._call(lambda: self._api.images(filters={"label": f"{VERSION}={__version__}"}))
        return {tag: each["Id"] for each in found for tag in each["RepoTags"] or []}

    async def volume(self, name: str) -> Path:
        """Return the directory of a volume on the host.

        Raises:
            NotFound: There is no such volume.
        """
        found = await self._call(lambda: self._api.inspect_volume(name))
        return Path(found["Mountpoint"])

    async def make_volume(self, name: str, task: Task) -> Path:
        """Create a volume that is removed with an environment; return its directory on the host."""
        labels = {**self._labels, ENVIRONMENT: task.name, RUN: task.run}
        found = await self._call(lambda: self._api.create_volume(name, labels=labels))
        return Path(found["Mountpoint"])

    async def set_group_address(self, run: str, network: str, address: str) -> None:
        """Replace the address that Swarm chose for a container in the network of its group."""
        await self._call(lambda: self._set_group_address(run, network, address))

    async def join_network(self, run: str, network: str, address: str) -> None:
        """Connect a container to a further network, unless it is connected."""
        await self._call(lambda: self._join_network(run, network, address))

    async def hosts_file(self, run: str) -> Path:
        """Return the path of a container's hosts file on the host.

        Raises:
            NotFound: There is no such container.
        """
        found = await self._call(lambda: self._api.inspect_container(self._id(run)))
        return Path(found["HostsPath"])

    async def apply_limits(self, request: LimitRequest) -> None:
        """Apply limits that need more privileges than the agent's container has; see `containers.swarm.privileged`.

        Raises:
            InvalidRequest: This node cannot apply a limit.
            StartFailed: A limit could not be applied.
        """
        status, output = await self._call(lambda: self._run_privileged(request))
        if status:
            lines = output.splitlines() or [f"exit status {status} without output"]
            try:
                raise RceError.from_info(msgspec.json.decode(lines[-1], type=ErrorInfo))
            except MALFORMED:
                raise StartFailed(f"its limits cannot be applied: {lines[-1]}") from None

    async def pull(self, call: PullImage) -> None:
        """Pull an image from the task set's registry and tag it.

        Raises:
            StartFailed: Docker could not pull it.
        """
        await self._call(lambda: self._pull(call))

    async def sweep(self, runs: set[str]) -> None:
        """Remove the volumes of all environments but these, and those of users who have no environment left."""
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

    def _set_group_address(self, run: str, network: str, address: str) -> None:
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

    def _pull(self, call: PullImage) -> None:
        repository, _, digest = call.source.partition("@")
        identity = {"username": call.user, "password": call.secret}
        try:
            for progress in self._api.pull(repository, digest, stream=True, decode=True, auth_config=identity):
                if "error" in progress:
                    raise StartFailed(f"image {call.tag} cannot be pulled: {progress['error']}")
            name, _, tag = call.tag.rpartition(":")
            self._api.tag(call.source, name, tag)
        except APIError as error:
            raise StartFailed(f"image {call.tag} cannot be pulled: {explanation(error)}") from None

    def _run_privileged(self, request: LimitRequest) -> tuple[int, str]:
        """Run the program in a container with the agent's image and mounts; return its exit status and output."""
        (own,) = self._api.containers(filters={"label": [*self._filter, AGENT]})
        seen = self._api.inspect_container(own["Id"])
        mounts = [
            Mount(each["Target"], each["Source"], type="bind", read_only=each.get("ReadOnly", False))
            for each in seen["HostConfig"]["Mounts"]
            if each["Type"] == "bind" and each["Target"] != DOCKER_SOCKET
        ]
        mounts += [Mount(path, path, type="bind") for path in ("/dev", "/sys/fs/cgroup")]
        made = self._api.create_container(
            seen["Image"],
            COMMAND,
            user="0:0",
            environment={REQUEST_VARIABLE: msgspec.json.encode(request).decode()},
            labels=self._labels,
            host_config=self._api.create_host_config(
                cap_add=PRIVILEGED_CAPABILITIES,
                device_cgroup_rules=["b *:* rwm", "c *:* rwm"],  # loop devices, including those created meanwhile
                security_opt=["apparmor=unconfined", "seccomp=unconfined", "label=disable"],
                pid_mode="host",
                network_mode="host",
                cgroupns="host",
                mounts=mounts,
                mem_limit=PRIVILEGED_MEMORY,
                pids_limit=PRIVILEGED_PROCESSES,
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
            if error.status_code != CONFLICT:  # in use by another environment of the same user
                raise

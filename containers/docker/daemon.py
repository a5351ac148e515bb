"""Containers of environments on one Docker daemon, managed off the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from docker.errors import APIError, ImageNotFound, NotFound
from msgspec import Struct

from containers.docker.api import AsyncDocker, explanation
from containers.docker.block_io import Machine
from containers.docker.disks import underlying_disk
from containers.docker.events import ENDS, Event, Events
from containers.docker.networks import ENVIRONMENT, Attachment
from containers.docker.options import ContainerOptions
from containers.docker.usage import used
from containers.process.tree import describe_end
from rce import __version__
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import StartFailed
from rce.protocol.slots import MB

RUN, SIZE, GPUS = "rce.run", "rce.size", "rce.gpus"
VERSION = "rce.version"  # of images
LONGEST_HOSTNAME = 63
STOP_TIMEOUT = 12  # seconds; the endpoint stops its nodes by SIGINT, SIGTERM and SIGKILL in less time
KILLED = 128 + 9  # exit status of a process that was killed, by the kernel or a person
STATE_TRIES, STATE_INTERVAL = 10, 0.2  # seconds
CONFLICT = 409  # HTTP status if another removal of the same container is under way


class Found(Struct, frozen=True):
    """A container of this task set."""

    id: str
    name: str
    run: str
    size: int
    running: bool
    gpus: list[str] = []


class State(Struct, frozen=True):
    """State of a container; `status` is 0 while it is `running`, `memory` is its limit in bytes."""

    status: int
    out_of_memory: bool
    memory: int
    running: bool = False


class Daemon(AsyncDocker):
    """Containers of one task set, which are those with `labels`."""

    def __init__(self, labels: Mapping[str, str]) -> None:
        super().__init__()
        self._labels = dict(labels)
        self._filter = [f"{key}={value}" for key, value in labels.items()]
        self._events: Events | None = None

    async def connect(self, on_event: Callable[[Event], None], on_resumed: Callable[[], None]) -> None:
        """Connect to the daemon and follow the ends of containers; see `Events`."""
        await self.connect_api()
        self._events = Events(self._api, {**ENDS, "event": ["die", "oom"], "label": self._filter}, on_event, on_resumed)
        self._events.start()

    def close(self) -> None:
        """Stop following events; no callback is called later."""
        if self._events is not None:
            self._events.close()

    async def start(
        self, found: Found, image: str, command: Sequence[str], variables: Mapping[str, str], options: ContainerOptions
    ) -> None:
        """Create a container and start it.

        Raises:
            StartFailed: The container did not start; it may have been created all the same.
        """
        await self._call(lambda: self._start(found, image, list(command), dict(variables), options))

    async def machine(self) -> Machine:
        """Return the properties of the daemon's machine on which container options depend."""
        return await self._call(self._machine)

    async def present(self) -> list[Found]:
        """Return all containers, running or not."""
        return await self._call(lambda: self._list(self._filter))

    async def remove(self, name: str) -> None:
        """Stop and remove the containers of an environment."""
        await self.remove_all(f"{ENVIRONMENT}={name}")

    async def remove_all(self, label: str) -> None:
        """Stop and remove the containers that have this label besides those of the task set."""
        await self._call(lambda: self._remove(label))

    async def state(self, run: str) -> State | None:
        """Return the state of a container; None if it does not exist.

        After a kill this waits up to two seconds for Docker to learn that the container was out of memory.
        """
        for _ in range(STATE_TRIES):
            state = await self._call(lambda: self._state(run))
            if state is None or state.status != KILLED or state.out_of_memory:
                break
            await asyncio.sleep(STATE_INTERVAL)
        return state

    async def process_id(self, run: str) -> int:
        """Return the process id, on the host, of the first process of a running container."""
        return await self._call(lambda: int(self._api.inspect_container(self._id(run))["State"]["Pid"]))

    async def last_lines(self, run: str, count: int) -> list[str]:
        """Return the last `count` lines of a container's output."""
        output = await self._call(lambda: self._output(run, count))
        return output.decode(errors="replace").splitlines()

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that running environments have used, by name."""
        running = await self._call(lambda: self._api.containers(filters={"label": [*self._filter, RUN]}))
        measured = await asyncio.gather(*(self._call(partial(used, self._api, each["Id"])) for each in running))
        names = [each["Labels"][ENVIRONMENT] for each in running]
        return {name: found for name, found in zip(names, measured, strict=True) if found is not None}

    # --- in threads ---------------------------------------------------------------------------------------------------

    def _start(
        self, found: Found, image: str, command: list[str], variables: dict[str, str], options: ContainerOptions
    ) -> None:
        try:
            self._check_image(image)
            networks = options.networks.networks
            made = self._api.create_container(
                image,
                command,
                name=_container(found.run),
                user=options.user,
                environment=variables,
                labels={**self._labels, **options.networks.labels, **_labels(found)},
                host_config=self._api.create_host_config(**options.host_config),
                hostname=options.networks.hostname[:LONGEST_HOSTNAME] or None,
                networking_config=self._endpoint(networks[0]) if networks else None,
            )
            for network in networks[1:]:
                self._api.connect_container_to_network(made["Id"], network.network, ipv4_address=network.address)
            self._api.start(made["Id"])
        except ImageNotFound:
            raise StartFailed(
                f"environment {found.name} did not start: this machine has no image {image}; "
                "`provisioning/provision image` builds those of the platform"
            ) from None
        except APIError as error:
            raise StartFailed(f"environment {found.name} did not start: {explanation(error)}") from None

    def _check_image(self, image: str) -> None:
        """Refuse an image that was built for another version, whose endpoint the Master would not admit."""
        built_for = (self._api.inspect_image(image)["Config"]["Labels"] or {}).get(VERSION)
        if built_for != __version__:
            fault = f"was built for RCE {built_for}" if built_for else f"has no label {VERSION}"
            raise StartFailed(
                f"image {image} {fault}, and this is RCE {__version__}: rebuild the platform's images with "
                "`provisioning/provision image`, and then your own images, which are based on them"
            )

    def _machine(self) -> Machine:
        info = self._api.info()
        try:
            image_device = underlying_disk(Path(info["DockerRootDir"]))
        except OSError:  # the directory is on another machine or in another mount namespace
            image_device = ""
        options = info.get("SecurityOptions") or []
        maps_users = any(each.startswith(("name=userns", "name=rootless")) for each in options)
        return Machine(image_device, info.get("CgroupVersion") == "2", maps_users)

    def _endpoint(self, network: Attachment) -> dict[str, Any]:
        settings = self._api.create_endpoint_config(ipv4_address=network.address, aliases=network.names)
        config: dict[str, Any] = self._api.create_networking_config({network.network: settings})
        return config

    def _list(self, labels: list[str]) -> list[Found]:
        return [
            Found(
                id=each["Id"],
                name=each["Labels"][ENVIRONMENT],
                run=each["Labels"][RUN],
                size=int(each["Labels"][SIZE]),
                running=each["State"] == "running",
                gpus=[id for id in each["Labels"].get(GPUS, "").split(",") if id],
            )
            for each in self._api.containers(all=True, filters={"label": labels})
        ]

    def _remove(self, label: str) -> None:
        for found in self._list([*self._filter, label]):
            try:
                self._api.stop(found.id, timeout=STOP_TIMEOUT)
                self._api.remove_container(found.id, force=True, v=True)
            except NotFound:
                continue
            except APIError as error:
                if error.status_code != CONFLICT:
                    raise

    def _state(self, run: str) -> State | None:
        try:
            seen = self._api.inspect_container(self._id(run))
        except NotFound:
            return None
        state = seen["State"]
        return State(state["ExitCode"], state["OOMKilled"], seen["HostConfig"]["Memory"], state["Running"])

    def _output(self, run: str, count: int) -> bytes:
        try:
            output: bytes = self._api.logs(self._id(run), tail=count)
        except NotFound:
            return b""
        return output

    def _id(self, run: str) -> str:
        """Return the id of the container of a run, which may have any name.

        Raises:
            NotFound: There is no such container.
        """
        found = self._api.containers(all=True, filters={"label": [*self._filter, f"{RUN}={run}"]})
        if not found:
            raise NotFound(f"run {run} has no container")
        container: str = found[0]["Id"]
        return container


def describe(state: State) -> tuple[int, str]:
    """Return the exit status of a container that has ended, negative for a signal, and a description of its end."""
    status = 128 - state.status if state.status > 128 else state.status
    reason = describe_end(status)
    if state.out_of_memory:
        reason += f"; it exceeded its memory of {state.memory // MB} MB"
    elif state.status == KILLED and state.memory:  # Docker misses the event of a container that has just started
        reason += f"; it may have exceeded its memory of {state.memory // MB} MB"
    return status, reason


def _labels(found: Found) -> dict[str, str]:
    labels = {ENVIRONMENT: found.name, RUN: found.run, SIZE: str(found.size)}
    return {**labels, GPUS: ",".join(found.gpus)} if found.gpus else labels


def _container(run: str) -> str:
    """Return the name of the container of a run."""
    return f"rce-{run}"

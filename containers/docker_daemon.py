"""What the engine `docker` asks of a Docker daemon, off the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from docker.errors import APIError, ImageNotFound, NotFound
from msgspec import Struct

from containers.docker_api import Asked, said
from containers.docker_disks import device_below
from containers.docker_events import ENDS, Event, Events
from containers.docker_networks import ENVIRONMENT, Attachment
from containers.docker_options import Machine, Walls
from containers.docker_used import used
from containers.processes import describe_end
from rce import __version__
from rce.calls.watching import Used
from rce.errors import StartFailed
from rce.slots import MB

RUN, SIZE, GPUS = "rce.run", "rce.size", "rce.gpus"
VERSION = "rce.version"  # of images
LONGEST_HOSTNAME = 63
STOP_TIMEOUT = 12  # seconds; the endpoint stops its nodes by SIGINT, SIGTERM, SIGKILL in less
KILLED = 128 + 9  # exit status of what the kernel or somebody else has killed
SECOND_LOOKS, PAUSE = 5, 0.2  # seconds
CONFLICT = 409  # another removal of the same container is under way


class Found(Struct, frozen=True):
    """A container of ours."""

    id: str
    name: str
    run: str
    size: int
    running: bool
    gpus: list[str] = []


class State(Struct, frozen=True):
    """A container that has ended; `memory` is its limit in bytes."""

    status: int
    out_of_memory: bool
    memory: int


class Daemon(Asked):
    """All containers made here get `labels`, and only what has them is seen."""

    def __init__(self, labels: Mapping[str, str]) -> None:
        super().__init__()
        self._labels = dict(labels)
        self._filter = [f"{key}={value}" for key, value in labels.items()]
        self._events: Events | None = None

    async def connect(self, happened: Callable[[Event], None], taken_up: Callable[[], None]) -> None:
        """Find the daemon and follow the ends of containers; see `Events`."""
        await self.reach()
        self._events = Events(self._api, {**ENDS, "event": ["die", "oom"], "label": self._filter}, happened, taken_up)
        self._events.start()

    def close(self) -> None:
        """Nothing is told after this."""
        if self._events is not None:
            self._events.close()

    async def start(
        self, found: Found, image: str, command: Sequence[str], variables: Mapping[str, str], walls: Walls
    ) -> None:
        """Make a container and start it. StartFailed; what was made of it by then stays."""
        await self._call(lambda: self._start(found, image, list(command), dict(variables), walls))

    async def machine(self) -> Machine:
        """What the walls must know of it."""
        return await self._call(self._machine)

    async def present(self) -> list[Found]:
        """All containers, alive or dead."""
        return await self._call(lambda: self._list(self._filter))

    async def remove(self, name: str) -> None:
        """Stop and remove the containers of an environment, if there are any."""
        await self.remove_all(f"{ENVIRONMENT}={name}")

    async def remove_all(self, label: str) -> None:
        """Stop and remove the containers with this label too, if there are any."""
        await self._call(lambda: self._remove(label))

    async def state(self, run: str) -> State | None:
        """How a container stands, None if there is none. That memory was used up Docker may know only after the end."""
        for _ in range(SECOND_LOOKS):
            state = await self._call(lambda: self._state(run))
            if state is None or state.status != KILLED or state.out_of_memory:
                break
            await asyncio.sleep(PAUSE)
        return state

    async def process(self, run: str) -> int:
        """The process id of a running container's first process, as the host sees it."""
        return await self._call(lambda: int(self._api.inspect_container(self._id(run))["State"]["Pid"]))

    async def last_lines(self, run: str, count: int) -> list[str]:
        """The last lines of output."""
        output = await self._call(lambda: self._output(run, count))
        return output.decode(errors="replace").splitlines()

    async def usage(self) -> dict[str, Used]:
        """What the environments that run have used, by name."""
        running = await self._call(lambda: self._api.containers(filters={"label": [*self._filter, RUN]}))
        measured = await asyncio.gather(*(self._call(partial(used, self._api, each["Id"])) for each in running))
        names = [each["Labels"][ENVIRONMENT] for each in running]
        return {name: found for name, found in zip(names, measured, strict=True) if found is not None}

    # --- in threads ---------------------------------------------------------------------------------------------------

    def _start(self, found: Found, image: str, command: list[str], variables: dict[str, str], walls: Walls) -> None:
        try:
            self._check_image(image)
            networks = walls.networks.networks
            made = self._api.create_container(
                image,
                command,
                name=_container(found.run),
                user=walls.user,
                environment=variables,
                labels={**self._labels, **walls.networks.labels, **_labels(found)},
                host_config=self._api.create_host_config(**walls.host_config),
                hostname=walls.networks.hostname[:LONGEST_HOSTNAME] or None,
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
            raise StartFailed(f"environment {found.name} did not start: {said(error)}") from None

    def _check_image(self, image: str) -> None:
        """Refuse one that was not built for this version: its endpoint would not be let in."""
        made_for = (self._api.inspect_image(image)["Config"]["Labels"] or {}).get(VERSION)
        if made_for != __version__:
            fault = f"was made for RCE {made_for}" if made_for else f"has no label {VERSION}"
            raise StartFailed(
                f"image {image} {fault}, and this is RCE {__version__}: `provisioning/provision image` builds the "
                "platform's images anew, and yours are to be built on them"
            )

    def _machine(self) -> Machine:
        known = self._api.info()
        try:
            ground = device_below(Path(known["DockerRootDir"]))
        except OSError:  # it is another machine's, or another mount name space's
            ground = ""
        return Machine(ground, known.get("CgroupVersion") == "2")

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
        return State(state["ExitCode"], state["OOMKilled"], seen["HostConfig"]["Memory"])

    def _output(self, run: str, count: int) -> bytes:
        try:
            output: bytes = self._api.logs(self._id(run), tail=count)
        except NotFound:
            return b""
        return output

    def _id(self, run: str) -> str:
        """The container of a life, whoever has named it; NotFound."""
        found = self._api.containers(all=True, filters={"label": [*self._filter, f"{RUN}={run}"]})
        if not found:
            raise NotFound(f"no container of {run}")
        container: str = found[0]["Id"]
        return container


def describe(state: State) -> tuple[int, str]:
    """The exit status of a container that has ended, negative if by a signal, and what happened."""
    status = 128 - state.status if state.status > 128 else state.status
    reason = describe_end(status)
    if state.out_of_memory:
        reason += f"; it had used up its memory of {state.memory // MB} MB"
    return status, reason


def _labels(found: Found) -> dict[str, str]:
    labels = {ENVIRONMENT: found.name, RUN: found.run, SIZE: str(found.size)}
    return {**labels, GPUS: ",".join(found.gpus)} if found.gpus else labels


def _container(run: str) -> str:
    """The name of a container."""
    return f"rce-{run}"

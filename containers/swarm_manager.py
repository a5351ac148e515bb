"""What the engine `swarm` asks of a manager of the swarm, off the event loop."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from docker.errors import APIError, NotFound
from docker.types import IPAMConfig, IPAMPool
from docker.utils import version_gte
from msgspec import Struct

from containers import swarm_images
from containers.docker_api import Asked, said
from containers.docker_daemon import RUN, SIZE, VERSION
from containers.docker_events import Event, Events
from containers.docker_networks import ENVIRONMENT, GROUP
from containers.limits import Size
from containers.swarm_spec import AGENT, GPU, swarms_half
from rce import __version__
from rce.errors import InvalidRequest, NoCapacity, StartFailed, TimedOut, Unavailable

API = "1.41"  # of Docker 20.10: services without capabilities, with limits of processes and open files
LOOK_EVERY = 0.05  # seconds between looks at a task that starts or ends: Swarm has no events of tasks
NETWORK_TRIES = 200


class Node(Struct, frozen=True):
    """A machine of the swarm; `usable` while Swarm keeps tasks on it."""

    id: str
    name: str
    usable: bool
    why: str  # it is not
    features: frozenset[str]
    size: Size
    gpus: int


class Network(Struct, frozen=True):
    """A network without a way out: of one environment, or with a subnet of its own that of a group."""

    name: str
    subnet: str = ""


class Found(Struct, frozen=True):
    """A service of ours: one life of an environment, on a node, an empty string while it has none."""

    service: str
    name: str
    run: str
    size: int
    network: str
    node: str
    running: bool


class Manager(Asked):
    """The services and networks made here get `labels`, and only what has them is seen."""

    def __init__(self, labels: Mapping[str, str]) -> None:
        super().__init__()
        self._labels = dict(labels)
        self._filter = [f"{key}={value}" for key, value in labels.items()]
        self._events: Events | None = None
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # of networks
        self.address = ""
        self.root = ""

    async def connect(self, happened: Callable[[Event], None], taken_up: Callable[[], None]) -> None:
        """Find the daemon and follow what happens to nodes; see `Events`. Unavailable if it is no manager."""
        await self.reach()
        info = await self._call(self._api.info)
        if not info["Swarm"].get("ControlAvailable"):
            raise Unavailable("this Docker is no manager of a swarm: `docker swarm init` makes it one")
        if not version_gte(self._api.api_version, API):
            raise Unavailable(f"the swarm engine needs Docker 20.10 or later, here is {info['ServerVersion']}")
        self.address = info["Swarm"]["NodeAddr"]
        self.root = str(info["DockerRootDir"])
        self._events = Events(self._api, {"type": "node", "event": ["update", "create", "remove"]}, happened, taken_up)
        self._events.start()

    def close(self) -> None:
        """Nothing is told after this."""
        if self._events is not None:
            self._events.close()

    async def nodes(self) -> dict[str, Node]:
        """By id."""
        found = await self._call(self._api.nodes)
        return {each["ID"]: _node(each) for each in found}

    async def present(self, name: str = "") -> list[Found]:
        """All lives of environments, or those of one."""
        return await self._call(lambda: self._present([f"{ENVIRONMENT}={name}"] if name else [RUN]))

    async def failure(self, service: str, node: str) -> str:
        """Why a service has no task on a node."""
        tasks = await self._call(lambda: self._tasks(service))
        errors = [
            task["Status"].get("Err") or task["Status"]["Message"] for task in tasks if task.get("NodeID") == node
        ]
        return errors[0] if errors else "Swarm has not placed it there"

    async def make(self, name: str, task: Mapping[str, Any], labels: Mapping[str, str], network: Network) -> None:
        """A service of one task, and its network unless that is there. StartFailed, TimedOut, Unavailable."""
        async with self._lock_of(network.name):
            await self._call(lambda: self._make(name, dict(task), {**self._labels, **labels}, network))

    async def release(self, network: str) -> None:
        """Remove a network unless an environment is in it: that of a group goes with its last member."""
        async with self._lock_of(network):
            if all(found.network != network for found in await self.present()):
                await self.remove_network(network)

    def _lock_of(self, network: str) -> asyncio.Lock:
        lock = self._locks.get(network)
        if lock is None:
            lock = self._locks[network] = asyncio.Lock()
        return lock

    async def running(self, name: str, service: str) -> str:
        """The node on which the task of a service runs, once it does. NoCapacity, StartFailed."""
        while True:
            tasks = await self._call(lambda: self._tasks(service))
            node = _judge(name, tasks[0]) if tasks else None
            if node is not None:
                return node
            await asyncio.sleep(LOOK_EVERY)

    async def remove(self, service: str) -> None:
        """Remove a service, if it is there; its task ends later."""
        await self._call(lambda: self._remove(service))

    async def ended(self, service: str, nodes: Collection[str]) -> None:
        """Until no task of a service that was removed is there any more, on these nodes or on its way to one."""
        while True:
            tasks = await self._call(lambda: self._tasks(service))
            if not any(task.get("NodeID", "") in {"", *nodes} for task in tasks):
                return
            await asyncio.sleep(LOOK_EVERY)

    async def remove_network(self, name: str) -> None:
        """Remove a network, if it is there, which the tasks in it may hold for a moment yet. TimedOut."""
        for _ in range(NETWORK_TRIES):
            if await self._call(lambda: self._remove_network(name)):
                return
            await asyncio.sleep(LOOK_EVERY)
        raise TimedOut(f"Docker does not remove the network {name}")

    async def networks(self) -> list[str]:
        """Names of our networks."""
        found = await self._call(lambda: self._api.networks(filters={"label": self._filter}))
        return [each["Name"] for each in found]

    async def image(self, tag: str) -> str | None:
        """The id of an image for this version on the manager's node."""
        return await self._call(lambda: self._image(tag))

    async def export(self, image: str, directory: Path) -> str:
        """See `swarm_images.export`. Unavailable if there is no room for it."""
        try:
            return await self._call(lambda: swarm_images.export(self._api, image, directory))
        except OSError as error:
            raise Unavailable(f"an image cannot be taken out of Docker for other nodes: {error}") from None

    async def forget(self, directory: Path) -> None:
        """Remove from `directory` what was exported of images that are no more."""
        await self._call(lambda: swarm_images.sweep(directory, self._api.images(quiet=True)))

    async def sign_in(self, registry: str, user: str, secret: str) -> None:
        """Have the nodes known at a registry from which they take images of services. Unavailable."""
        await self._call(lambda: self._api.login(user, secret, registry=f"http://{registry}", reauth=True))

    async def keep_agents(self, name: str, task: Mapping[str, Any]) -> None:
        """Have one agent on each node, made or updated. StartFailed."""
        await self._call(lambda: self._keep_agents(name, dict(task)))

    # --- in threads ---------------------------------------------------------------------------------------------------

    def _present(self, wanted: Sequence[str]) -> list[Found]:
        found = []
        for each in self._api.services(filters={"label": [*self._filter, *wanted]}):
            labels = each["Spec"]["Labels"]
            service = each["Spec"]["Name"]
            tasks = self._tasks(service)
            running = any(task["Status"]["State"] == "running" for task in tasks)
            node = tasks[0].get("NodeID", "") if tasks else ""
            network = labels.get(GROUP, service)
            found.append(Found(service, labels[ENVIRONMENT], labels[RUN], int(labels[SIZE]), network, node, running))
        return found

    def _tasks(self, service: str) -> list[dict[str, Any]]:
        tasks: list[dict[str, Any]] = self._api.tasks(filters={"name": service})
        return tasks

    def _make(self, name: str, task: dict[str, Any], labels: dict[str, str], network: Network) -> None:
        try:
            self._make_network(network)
            self._api.create_service(
                task, name, labels, {"Replicated": {"Replicas": 1}}, endpoint_spec={"Mode": "dnsrr"}
            )
        except APIError as error:
            raise StartFailed(f"environment {labels[ENVIRONMENT]} did not start: {said(error)}") from None

    def _make_network(self, network: Network) -> None:
        ipam = None
        if network.subnet:
            pool = IPAMPool(subnet=network.subnet, iprange=str(swarms_half(network.subnet)))
            ipam = IPAMConfig(pool_configs=[pool])
        if not network.subnet or not self._api.networks(names=[network.name]):
            self._api.create_network(
                network.name, driver="overlay", internal=True, labels=self._labels, scope="swarm", ipam=ipam
            )

    def _remove(self, service: str) -> None:
        try:
            self._api.remove_service(service)
        except NotFound:
            return

    def _remove_network(self, name: str) -> bool:
        """Whether it is gone, also from this node."""
        with suppress(APIError):
            self._api.remove_network(name)
        return not self._api.networks(names=[name])

    def _image(self, tag: str) -> str | None:
        try:
            found = self._api.inspect_image(tag)
        except NotFound:
            return None
        made_for = (found["Config"]["Labels"] or {}).get(VERSION)
        return str(found["Id"]) if made_for == __version__ else None

    def _keep_agents(self, name: str, task: dict[str, Any]) -> None:
        labels = {**self._labels, AGENT: "yes"}
        mode: dict[str, Any] = {"Global": {}}
        try:
            service = self._api.inspect_service(name)
        except NotFound:
            self._api.create_service(task, name, labels, mode, endpoint_spec={"Mode": "dnsrr"})
            return
        if service["Spec"]["Labels"] != labels:
            raise InvalidRequest(f"the swarm has a service {name} that is not this task set's: give this one a name")
        self._api.update_service(
            service["ID"], service["Version"]["Index"], task, name, labels, mode, endpoint_spec={"Mode": "dnsrr"}
        )


def _node(found: Mapping[str, Any]) -> Node:
    state, availability = found["Status"]["State"], found["Spec"]["Availability"]
    name = found["Description"]["Hostname"] or found["ID"]
    why = "" if state == "ready" else f"node {name} is {state}"
    if availability == "drain":
        why = f"node {name} is drained"
    prefix = "rce.feature."
    labels: Mapping[str, str] = found["Spec"].get("Labels") or {}
    features = frozenset(key.removeprefix(prefix) for key, value in labels.items() if key.startswith(prefix) and value)
    has = found["Description"]["Resources"]
    return Node(found["ID"], name, not why, why, features, Size(has["NanoCPUs"] / 1e9, has["MemoryBytes"]), _gpus(has))


def _gpus(resources: Mapping[str, Any]) -> int:
    """The administrator names each, or says how many there are."""
    count = 0
    for each in resources.get("GenericResources") or []:
        for resource in each.values():
            if resource["Kind"] == GPU:
                count += int(resource["Value"]) if "DiscreteResourceSpec" in each else 1
    return count


def _judge(name: str, task: Mapping[str, Any]) -> str | None:
    """The node of a task that runs, or has run; None while that is open. NoCapacity, StartFailed."""
    status = task["Status"]
    error = status.get("Err", "")
    match status["State"]:
        case "running" | "complete" | "shutdown":
            return str(task["NodeID"])
        case "pending" if "no suitable node" in error:
            raise NoCapacity(f"environment {name}: the swarm has {error}")
        case "failed" if error.startswith("task: non-zero exit"):
            return str(task["NodeID"])
        case "failed" | "rejected" | "orphaned" | "remove":
            raise StartFailed(f"environment {name} did not start: {error or status['State']}")
    return None

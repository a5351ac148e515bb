"""Access of the engine `swarm` to a manager of the swarm, off the event loop."""

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

from containers.docker.api import AsyncDocker, explanation
from containers.docker.daemon import RUN, SIZE, VERSION
from containers.docker.events import Event, Events
from containers.docker.networks import ENVIRONMENT, GROUP
from containers.limits import Size
from containers.swarm import images
from containers.swarm.spec import AGENT, GPU, swarm_range
from rce import __version__
from rce.errors import InvalidRequest, NoCapacity, StartFailed, TimedOut, Unavailable, disk_full

API = "1.41"  # Docker 20.10, the first with services without capabilities and limits of processes and open files
POLL_INTERVAL = 0.05  # seconds between queries of a task that starts or ends: Swarm has no events for tasks
NETWORK_TRIES = 200


class Node(Struct, frozen=True):
    """A machine of the swarm.

    `usable` is True while Swarm keeps tasks on it; otherwise `unusable_reason` says why not.
    """

    id: str
    name: str
    usable: bool
    unusable_reason: str
    features: frozenset[str]
    size: Size
    gpus: int


class Network(Struct, frozen=True):
    """An internal network, of a group if it has a `subnet`, otherwise of a single environment."""

    name: str
    subnet: str = ""


class Found(Struct, frozen=True):
    """A service of this task set, which is one run of an environment; `node` is empty until it is placed."""

    service: str
    name: str
    run: str
    size: int
    network: str
    node: str
    running: bool


class Manager(AsyncDocker):
    """Services and networks of one task set, which are those with `labels`."""

    def __init__(self, labels: Mapping[str, str]) -> None:
        super().__init__()
        self._labels = dict(labels)
        self._filter = [f"{key}={value}" for key, value in labels.items()]
        self._events: Events | None = None
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # of networks
        self.address = ""
        self.root = ""

    async def connect(self, on_event: Callable[[Event], None], resumed: Callable[[], None]) -> None:
        """Connect to the daemon and follow the events of nodes; see `Events`.

        Raises:
            Unavailable: The daemon does not answer, is not a manager of a swarm, or is too old.
        """
        await self.connect_api()
        info = await self._call(self._api.info)
        if not info["Swarm"].get("ControlAvailable"):
            raise Unavailable("this Docker is not a manager of a swarm: `docker swarm init` makes it one")
        if not version_gte(self._api.api_version, API):
            raise Unavailable(f"the swarm engine needs Docker 20.10 or later; this is {info['ServerVersion']}")
        self.address = info["Swarm"]["NodeAddr"]
        self.root = str(info["DockerRootDir"])
        self._events = Events(self._api, {"type": "node", "event": ["update", "create", "remove"]}, on_event, resumed)
        self._events.start()

    def close(self) -> None:
        """Stop following events; no callback is called later."""
        if self._events is not None:
            self._events.close()

    async def nodes(self) -> dict[str, Node]:
        """Return the nodes of the swarm by id."""
        found = await self._call(self._api.nodes)
        return {each["ID"]: _node(each) for each in found}

    async def present(self, name: str = "") -> list[Found]:
        """Return the services of all environments, or those of the environment `name`."""
        return await self._call(lambda: self._present([f"{ENVIRONMENT}={name}"] if name else [RUN]))

    async def failure(self, service: str, node: str) -> str:
        """Return the reason why a service has no running task on a node."""
        tasks = await self._call(lambda: self._tasks(service))
        errors = [
            task["Status"].get("Err") or task["Status"]["Message"] for task in tasks if task.get("NodeID") == node
        ]
        return errors[0] if errors else "Swarm has not placed a task there"

    async def create_service(
        self, name: str, task: Mapping[str, Any], labels: Mapping[str, str], network: Network
    ) -> None:
        """Create a service of one task, and its network unless that exists.

        Raises:
            StartFailed: Swarm refuses the service.
            Unavailable: Docker does not answer.
        """
        async with self._lock_of(network.name):
            await self._call(lambda: self._create_service(name, dict(task), {**self._labels, **labels}, network))

    async def remove_unused_network(self, network: str) -> None:
        """Remove a network unless an environment is in it; a group's network goes with its last member."""
        async with self._lock_of(network):
            if all(found.network != network for found in await self.present()):
                await self.remove_network(network)

    def _lock_of(self, network: str) -> asyncio.Lock:
        lock = self._locks.get(network)
        if lock is None:
            lock = self._locks[network] = asyncio.Lock()
        return lock

    async def wait_until_running(self, name: str, service: str) -> str:
        """Wait until the task of a service runs; return the id of its node.

        Raises:
            NoCapacity: No node has the resources that the environment `name` reserves.
            StartFailed: The task cannot start.
        """
        while True:
            tasks = await self._call(lambda: self._tasks(service))
            node = _node_of_started(name, tasks[0]) if tasks else None
            if node is not None:
                return node
            await asyncio.sleep(POLL_INTERVAL)

    async def remove_service(self, service: str) -> None:
        """Remove a service if it exists; its task ends later."""
        await self._call(lambda: self._remove_service(service))

    async def wait_until_ended(self, service: str, nodes: Collection[str]) -> None:
        """Wait until no task of a removed service is on one of these nodes or still to be placed."""
        while True:
            tasks = await self._call(lambda: self._tasks(service))
            if not any(task.get("NodeID", "") in {"", *nodes} for task in tasks):
                return
            await asyncio.sleep(POLL_INTERVAL)

    async def remove_network(self, name: str) -> None:
        """Remove a network if it exists; wait for tasks that end to leave it.

        Raises:
            TimedOut: The network is still in use after NETWORK_TRIES.
        """
        for _ in range(NETWORK_TRIES):
            if await self._call(lambda: self._remove_network(name)):
                return
            await asyncio.sleep(POLL_INTERVAL)
        raise TimedOut(f"Docker does not remove the network {name}")

    async def networks(self) -> list[str]:
        """Return the names of the task set's networks."""
        found = await self._call(lambda: self._api.networks(filters={"label": self._filter}))
        return [each["Name"] for each in found]

    async def image_id(self, tag: str) -> str | None:
        """Return the id of an image on the manager's node; None if it is missing or for another version of RCE."""
        return await self._call(lambda: self._image_id(tag))

    async def export(self, image: str, directory: Path) -> str:
        """Export an image to `directory`; see `containers.swarm.images.export`.

        Raises:
            Unavailable: The files cannot be written, for example because the disk is full.
        """
        try:
            return await self._call(lambda: images.export(self._api, image, directory))
        except OSError as error:
            reason = disk_full(error) or error
            raise Unavailable(f"an image cannot be exported from Docker for other nodes: {reason}") from None

    async def sweep_exports(self, directory: Path) -> None:
        """Remove exports of images that no longer exist from `directory`."""
        await self._call(lambda: images.sweep(directory, self._api.images(quiet=True)))

    async def sign_in(self, registry: str, user: str, secret: str) -> None:
        """Log in to a registry from which nodes pull images of services.

        Raises:
            Unavailable: Docker cannot reach the registry, or does not accept it.
        """
        await self._call(lambda: self._api.login(user, secret, registry=f"http://{registry}", reauth=True))

    async def update_agent_service(self, name: str, task: Mapping[str, Any]) -> None:
        """Create or update the service that runs one agent on each node.

        Raises:
            InvalidRequest: A service of another owner has this name.
        """
        await self._call(lambda: self._update_agent_service(name, dict(task)))

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

    def _create_service(self, name: str, task: dict[str, Any], labels: dict[str, str], network: Network) -> None:
        try:
            self._create_network(network)
            self._api.create_service(
                task, name, labels, {"Replicated": {"Replicas": 1}}, endpoint_spec={"Mode": "dnsrr"}
            )
        except APIError as error:
            raise StartFailed(f"environment {labels[ENVIRONMENT]} did not start: {explanation(error)}") from None

    def _create_network(self, network: Network) -> None:
        ipam = None
        if network.subnet:
            pool = IPAMPool(subnet=network.subnet, iprange=str(swarm_range(network.subnet)))
            ipam = IPAMConfig(pool_configs=[pool])
        if not network.subnet or not self._api.networks(names=[network.name]):
            self._api.create_network(
                network.name, driver="overlay", internal=True, labels=self._labels, scope="swarm", ipam=ipam
            )

    def _remove_service(self, service: str) -> None:
        try:
            self._api.remove_service(service)
        except NotFound:
            return

    def _remove_network(self, name: str) -> bool:
        """Try to remove a network; return True if it is gone, also from this node."""
        with suppress(APIError):
            self._api.remove_network(name)
        return not self._api.networks(names=[name])

    def _image_id(self, tag: str) -> str | None:
        try:
            found = self._api.inspect_image(tag)
        except NotFound:
            return None
        made_for = (found["Config"]["Labels"] or {}).get(VERSION)
        return str(found["Id"]) if made_for == __version__ else None

    def _update_agent_service(self, name: str, task: dict[str, Any]) -> None:
        labels = {**self._labels, AGENT: "yes"}
        mode: dict[str, Any] = {"Global": {}}
        try:
            service = self._api.inspect_service(name)
        except NotFound:
            self._api.create_service(task, name, labels, mode, endpoint_spec={"Mode": "dnsrr"})
            return
        if service["Spec"]["Labels"] != labels:
            raise InvalidRequest(
                f"the swarm has a service {name} of another task set: give this task set a name of its own"
            )
        self._api.update_service(
            service["ID"], service["Version"]["Index"], task, name, labels, mode, endpoint_spec={"Mode": "dnsrr"}
        )


def _node(found: Mapping[str, Any]) -> Node:
    state, availability = found["Status"]["State"], found["Spec"]["Availability"]
    name = found["Description"]["Hostname"] or found["ID"]
    unusable_reason = "" if state == "ready" else f"node {name} is {state}"
    if availability == "drain":
        unusable_reason = f"node {name} is drained"
    prefix = "rce.feature."
    labels: Mapping[str, str] = found["Spec"].get("Labels") or {}
    features = frozenset(key.removeprefix(prefix) for key, value in labels.items() if key.startswith(prefix) and value)
    resources = found["Description"]["Resources"]
    size = Size(resources["NanoCPUs"] / 1e9, resources["MemoryBytes"])
    return Node(found["ID"], name, not unusable_reason, unusable_reason, features, size, _gpus(resources))


def _gpus(resources: Mapping[str, Any]) -> int:
    """Count the GPUs that the administrator has configured, either each by name or as a number."""
    count = 0
    for each in resources.get("GenericResources") or []:
        for resource in each.values():
            if resource["Kind"] == GPU:
                count += int(resource["Value"]) if "DiscreteResourceSpec" in each else 1
    return count


def _node_of_started(name: str, task: Mapping[str, Any]) -> str | None:
    """Return the node of a task that runs or has run; None while it is not yet decided.

    Raises:
        NoCapacity: No node has the resources.
        StartFailed: The task cannot start.
    """
    status = task["Status"]
    error = status.get("Err", "")
    match status["State"]:
        case "running" | "complete" | "shutdown":
            return str(task["NodeID"])
        case "pending" if "no suitable node" in error:
            raise NoCapacity(f"environment {name} cannot be placed: the swarm has {error}")
        case "failed" if error.startswith("task: non-zero exit"):
            return str(task["NodeID"])
        case "failed" | "rejected" | "orphaned" | "remove":
            raise StartFailed(f"environment {name} did not start: {error or status['State']}")
    return None

"""Docker networks of environments. The platform's own connections do not use them.

A *group network* is a bridge for the environments of one user's group. The host has no address on it and it has no
route out. It exists as long as it has members. Docker's resolver maps the containerTags of members, including those
that join later, to their addresses.

An *egress network* is a bridge for a single environment whose user's policy allows connections to the outside. Nothing
connects in from outside.

Networks are found again after a crash by their labels, and their members by the labels of the containers.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Coroutine, Mapping, Sequence
from ipaddress import IPv4Network
from typing import Any, Protocol, TypeVar
from weakref import WeakValueDictionary

import docker
from docker.errors import NotFound
from docker.types import IPAMConfig, IPAMPool
from msgspec import Struct
from twisted.logger import Logger

from containers.docker.firewall import Firewall, Rule, egress_rules, group_rules
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.errors import StartFailed, Unavailable

log = Logger()
ENVIRONMENT, GROUP, EGRESS = "rce.environment", "rce.group", "rce.egress"
BRIDGE, NO_ADDRESS = "com.docker.network.bridge.name", "com.docker.network.bridge.inhibit_ipv4"
GROUP_OPTIONS = {NO_ADDRESS: "true", "com.docker.network.driver.mtu": "65000"}  # large, as it never leaves this machine
EGRESS_PREFIX = 30  # room for the addresses of the bridge and the environment
NO_NAMESERVER = (
    "127.0.0.1"  # Docker's resolver queries it from within the container, so only names of the group resolve
)
CHECK_INTERVAL = 2.0  # seconds between checks of the packet filter
R = TypeVar("R")


class DockerCall(Protocol):
    """Runs a function with Docker's API off the event loop; see `AsyncDocker.call`."""

    def __call__(self, work: Callable[[docker.APIClient], R]) -> Coroutine[None, None, R]:
        """Run `work`; return its result."""


class Attachment(Struct, frozen=True):
    """A container's connection to a network; the others there resolve `names` to its address."""

    network: str
    address: str
    names: list[str] = []


class Attachments(Struct, frozen=True):
    """All networks of a container, and the container options that depend on them."""

    networks: list[Attachment] = []
    labels: dict[str, str] = {}
    hostname: str = ""
    dns: tuple[str, ...] = (NO_NAMESERVER,)


class Network(Struct, frozen=True):
    """Description of a network to create; its labels say what kind of network it is and whose."""

    name: str
    labels: dict[str, str]
    subnet: str
    bridge: str
    rules: list[Rule]


def identity(*words: str) -> str:
    """Return 16 hex digits that stand for `words` in names of limited length."""
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


def group_network(platform: Mapping[str, str], name: str) -> str:
    """Return Docker's name for the network of a group; `platform` are the labels of the task set."""
    return f"rce-group-{identity(*platform.values(), name)}"


def egress_network(platform: Mapping[str, str], environment: str) -> str:
    """Return Docker's name for the egress network of an environment."""
    return f"rce-egress-{identity(*platform.values(), environment)}"


class Networks:
    """The networks of one task set's environments, which are those with `labels`.

    Each egress network gets a subnet of `pool`, and its environment uses these `nameservers`.
    """

    def __init__(self, call: DockerCall, labels: Mapping[str, str], pool: str, nameservers: Sequence[str]) -> None:
        self._call = call
        self._pool = IPv4Network(pool)
        self._nameservers = tuple(nameservers)
        self._allocating = asyncio.Lock()  # held from the choice of a subnet until its network exists
        self._labels = dict(labels)
        self._filters = {"label": [f"{key}={value}" for key, value in labels.items()]}
        self._firewall = Firewall()
        self._members: dict[str, set[str]] = {}  # environments by network
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def join(self, spec: EnvironmentSpec) -> Attachments:
        """Create the networks that a starting environment needs and does not find; return them all.

        Raises:
            StartFailed: A network cannot be created or filtered.
        """
        try:
            group = await self._join_group(spec.name, spec.group) if spec.group else Attachments()
            return group if spec.egress == "none" else await self._join_egress(group, spec)
        except Unavailable as error:
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    async def leave(self, environment: str) -> None:
        """Remove an environment, whose container is gone, from its networks; remove networks without members.

        It is a member until its networks are removed, so that a second call waits for the first.
        """
        for name in [name for name, members in self._members.items() if environment in members]:
            await self._remove_unused(name, environment)

    async def recover(self) -> None:
        """Adopt the networks of an earlier task set and restore their rules; remove unused networks and rules."""
        for name, environment in await self._call(self._memberships):
            self._members.setdefault(name, set()).add(environment)
        present = await self._call(self._present)
        for network in present:
            await self._remove_unused(network.name)
        try:
            await self.restore_rules()
            await self._firewall.sweep()
        except Unavailable as error:
            if present:
                log.error("networks of environments are not filtered: {error}", error=str(error))

    async def restore_rules(self) -> None:
        """Set the rules of all networks again, as other programs may have flushed the packet filter."""
        for network in await self._call(self._present):
            await self._firewall.set_rules(network.bridge, network.rules)

    async def watch(self) -> None:
        """Check the packet filter again and again, until cancelled."""
        while True:
            await asyncio.sleep(CHECK_INTERVAL)
            try:
                await self.check_rules()
            except (Unavailable, OSError) as error:
                log.error("the rules of environments' networks cannot be checked: {error}", error=str(error))

    async def check_rules(self) -> None:
        """Restore the rules if another program has flushed them.

        Raises:
            Unavailable: Docker or the packet filter cannot be used.
        """
        if await self._firewall.changed():
            log.warn("another program has removed the rules of environments' networks; they are set again")
            await self._firewall.restore_chain()
            await self.restore_rules()

    # --- internal -----------------------------------------------------------------------------------------------------

    async def _join_group(self, environment: str, group: Group) -> Attachments:
        name = group_network(self._labels, group.name)
        labels = {GROUP: group.name}
        self._members.setdefault(name, set()).add(environment)
        await self._create(_network(name, {**self._labels, **labels}, group.subnet))
        tag = environment.partition("/")[2]
        return Attachments([Attachment(name, group.address, [tag])], labels, tag)

    async def _join_egress(self, group: Attachments, spec: EnvironmentSpec) -> Attachments:
        name = egress_network(self._labels, spec.name)
        labels = {EGRESS: spec.egress}
        self._members.setdefault(name, set()).add(spec.name)
        async with self._allocating:
            subnet = await self._call(self._free_subnet)
            await self._create(_network(name, {**self._labels, **labels, ENVIRONMENT: spec.name}, str(subnet)))
        return Attachments(
            [Attachment(name, str(subnet[2])), *group.networks],
            {**group.labels, **labels},
            group.hostname,
            self._nameservers,
        )

    async def _create(self, network: Network) -> None:
        async with self._lock(network.name):
            await self._call(lambda api: _create(api, network))
            await self._firewall.set_rules(network.bridge, network.rules)

    async def _remove_unused(self, name: str, leaving: str = "") -> None:
        """Remove a network that has no members but the one that is leaving; then that one has left."""
        async with self._lock(name):
            members = self._members.get(name, set())
            if leaving and leaving not in members:
                return
            if not members - {leaving}:
                await self._remove(name)
            members.discard(leaving)
            if not members:
                self._members.pop(name, None)

    async def _remove(self, name: str) -> None:
        bridge = await self._call(lambda api: _remove(api, name))
        try:
            if bridge:
                await self._firewall.remove_rules(bridge)
        except Unavailable as error:  # harmless without the bridge; the next task set removes them when it starts
            log.warn("the rules for {bridge} were not removed: {error}", bridge=bridge, error=str(error))

    def _lock(self, name: str) -> asyncio.Lock:
        lock = self._locks.get(name)
        if lock is None:
            lock = self._locks[name] = asyncio.Lock()
        return lock

    # --- in threads ---------------------------------------------------------------------------------------------------

    def _present(self, api: docker.APIClient) -> list[Network]:
        return [_read(each) for each in api.networks(filters={**self._filters, "driver": "bridge"})]

    def _memberships(self, api: docker.APIClient) -> list[tuple[str, str]]:
        labels = [each["Labels"] for each in api.containers(all=True, filters=self._filters)]
        groups = [(group_network(self._labels, each[GROUP]), each[ENVIRONMENT]) for each in labels if GROUP in each]
        names = [each[ENVIRONMENT] for each in labels if EGRESS in each]
        return groups + [(egress_network(self._labels, name), name) for name in names]

    def _free_subnet(self, api: docker.APIClient) -> IPv4Network:
        """Return a subnet of the pool that overlaps with no network of this daemon, whoever created it."""
        configs = [config for each in api.networks() for config in each["IPAM"]["Config"] or []]
        taken = [IPv4Network(config["Subnet"]) for config in configs if ":" not in config["Subnet"]]
        for subnet in self._pool.subnets(new_prefix=EGRESS_PREFIX):
            if not any(subnet.overlaps(other) for other in taken):
                return subnet
        raise Unavailable(f"all subnets of the egress pool {self._pool} are in use: set a larger egress_pool")


def _network(name: str, labels: Mapping[str, str], subnet: str) -> Network:
    bridge = f"rce-{name.rpartition('-')[2][:10]}"  # interface names have at most 15 characters
    rules = egress_rules(bridge, labels[EGRESS]) if EGRESS in labels else group_rules(bridge)
    return Network(name, dict(labels), subnet, bridge, rules)


def _read(seen: Mapping[str, Any]) -> Network:
    return _network(seen["Name"], seen["Labels"], seen["IPAM"]["Config"][0]["Subnet"])


def _create(api: docker.APIClient, network: Network) -> None:
    try:
        if _read(api.inspect_network(network.name)) == network:
            return
        api.remove_network(network.name)  # an earlier group or environment had this name
    except NotFound:
        pass
    internal = EGRESS not in network.labels
    api.create_network(
        network.name,
        driver="bridge",
        options={BRIDGE: network.bridge, **(GROUP_OPTIONS if internal else {})},
        ipam=IPAMConfig(pool_configs=[IPAMPool(subnet=network.subnet)]),
        check_duplicate=True,
        internal=internal,
        labels=network.labels,
    )


def _remove(api: docker.APIClient, name: str) -> str:
    """Remove a network; return its bridge, or an empty string if there is no such network."""
    try:
        bridge = _read(api.inspect_network(name)).bridge
        api.remove_network(name)
    except NotFound:
        return ""
    return bridge

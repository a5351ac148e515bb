"""Networks of environments under Docker, beside the platform's own path, which needs none.

A *group network* is a bridge for the environments of one user's group: the host has no address on it, and nothing leads
out of it. It is there from its first member to its last. Docker's resolver answers members with the addresses of
members, by their containerTags, also of those that come later.

An *egress network* is a bridge for one environment, to which its user's policy allows to reach out. Nobody else is on
it, and nothing comes in from outside.

Labels say whose a network is; after a crash it is found by them, and its members by the labels of their containers.
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

from containers.firewall import Firewall, Rule, for_egress, for_group
from rce.calls.environments import EnvironmentSpec, Group
from rce.errors import StartFailed, Unavailable

log = Logger()
ENVIRONMENT, GROUP, EGRESS = "rce.environment", "rce.group", "rce.egress"
BRIDGE, NO_ADDRESS = "com.docker.network.bridge.name", "com.docker.network.bridge.inhibit_ipv4"
WITHIN = {NO_ADDRESS: "true", "com.docker.network.driver.mtu": "65000"}  # it never leaves this machine
EGRESS_PREFIX = 30  # the bridge and the environment
NO_NAMESERVER = "127.0.0.1"  # Docker's resolver asks it from within the container: only names of the group are found
R = TypeVar("R")


class Ask(Protocol):
    """Asks Docker off the event loop; raises Unavailable."""

    def __call__(self, work: Callable[[docker.APIClient], R]) -> Coroutine[None, None, R]: ...


class Attachment(Struct, frozen=True):
    """A container's place in a network; `names` are what others there call it."""

    network: str
    address: str
    names: list[str] = []


class Attachments(Struct, frozen=True):
    """All networks of a container, and what it needs besides. Without any it has not even a resolver."""

    networks: list[Attachment] = []
    labels: dict[str, str] = {}
    hostname: str = ""
    dns: tuple[str, ...] = (NO_NAMESERVER,)


class Network(Struct, frozen=True):
    """A network as it shall be made; whose it is, and so what it may, its labels say."""

    name: str
    labels: dict[str, str]
    subnet: str
    bridge: str
    rules: list[Rule]


def identity(*words: str) -> str:
    """16 hex digits that stand for `words` in names, which Docker and the kernel keep short."""
    return hashlib.sha256("\0".join(words).encode()).hexdigest()[:16]


def group_network(platform: Mapping[str, str], name: str) -> str:
    """Docker's name for the network of a group; `platform` are the labels of all that a task set makes."""
    return f"rce-group-{identity(*platform.values(), name)}"


def egress_network(platform: Mapping[str, str], environment: str) -> str:
    """Docker's name for the network by which an environment reaches out."""
    return f"rce-egress-{identity(*platform.values(), environment)}"


class Networks:
    """The networks of one task set's environments. `labels` are those of all that it makes.

    Each egress network gets a subnet out of `pool`; who has one asks these `nameservers`.
    """

    def __init__(self, ask: Ask, labels: Mapping[str, str], pool: str, nameservers: Sequence[str]) -> None:
        self._ask = ask
        self._pool = IPv4Network(pool)
        self._nameservers = tuple(nameservers)
        self._choosing = asyncio.Lock()  # of a subnet
        self._labels = dict(labels)
        self._filters = {"label": [f"{key}={value}" for key, value in labels.items()]}
        self._firewall = Firewall()
        self._members: dict[str, set[str]] = {}  # environments by network
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def join(self, spec: EnvironmentSpec) -> Attachments:
        """The networks of an environment that starts; they are made, unless they are there. StartFailed."""
        try:
            group = await self._join_group(spec.name, spec.group) if spec.group else Attachments()
            return group if spec.egress == "none" else await self._reach_out(group, spec)
        except Unavailable as error:
            raise StartFailed(f"environment {spec.name} did not start: {error}") from None

    async def leave(self, environment: str) -> None:
        """Its container is gone: networks that have no other member go too."""
        for name in [name for name, members in self._members.items() if environment in members]:
            self._members[name].discard(environment)
            await self._remove_unused(name)

    async def recover(self) -> None:
        """Take up what an earlier task set made: members by their containers, rules; what is unused is removed."""
        for name, environment in await self._ask(self._memberships):
            self._members.setdefault(name, set()).add(environment)
        present = await self._ask(self._present)
        for network in present:
            await self._remove_unused(network.name)
        try:
            await self.guard()
            await self._firewall.sweep()
        except Unavailable as error:
            if present:
                log.error("networks of environments are not guarded: {error}", error=str(error))

    async def guard(self) -> None:
        """Put the rules of all networks again: others who change the packet filter may have removed them."""
        for network in await self._ask(self._present):
            await self._firewall.put(network.bridge, network.rules)

    # --- within -------------------------------------------------------------------------------------------------------

    async def _join_group(self, environment: str, group: Group) -> Attachments:
        name = group_network(self._labels, group.name)
        labels = {GROUP: group.name}
        self._members.setdefault(name, set()).add(environment)
        await self._make(_network(name, {**self._labels, **labels}, group.subnet))
        tag = environment.partition("/")[2]
        return Attachments([Attachment(name, group.address, [tag])], labels, tag)

    async def _reach_out(self, group: Attachments, spec: EnvironmentSpec) -> Attachments:
        name = egress_network(self._labels, spec.name)
        labels = {EGRESS: spec.egress}
        self._members.setdefault(name, set()).add(spec.name)
        async with self._choosing:
            subnet = await self._ask(self._free_subnet)
            await self._make(_network(name, {**self._labels, **labels, ENVIRONMENT: spec.name}, str(subnet)))
        return Attachments(
            [Attachment(name, str(subnet[2])), *group.networks],
            {**group.labels, **labels},
            group.hostname,
            self._nameservers,
        )

    async def _make(self, network: Network) -> None:
        async with self._lock(network.name):
            await self._ask(lambda api: _create(api, network))
            await self._firewall.put(network.bridge, network.rules)

    async def _remove_unused(self, name: str) -> None:
        async with self._lock(name):
            if self._members.get(name):
                return
            self._members.pop(name, None)
            bridge = await self._ask(lambda api: _remove(api, name))
            try:
                if bridge:
                    await self._firewall.remove(bridge)
            except Unavailable as error:  # they do no harm without their bridge, and go when a task set starts
                log.warn("rules for {bridge} are left: {error}", bridge=bridge, error=str(error))

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
        """One that overlaps with no network of this daemon, also those of others."""
        configs = [config for each in api.networks() for config in each["IPAM"]["Config"] or []]
        taken = [IPv4Network(config["Subnet"]) for config in configs if ":" not in config["Subnet"]]
        for subnet in self._pool.subnets(new_prefix=EGRESS_PREFIX):
            if not any(subnet.overlaps(other) for other in taken):
                return subnet
        raise Unavailable(f"all networks of the pool {self._pool} for environments that reach out are in use")


def _network(name: str, labels: Mapping[str, str], subnet: str) -> Network:
    bridge = f"rce-{name.rpartition('-')[2][:10]}"  # an interface's name has 15 letters at most
    rules = for_egress(bridge, labels[EGRESS] == "all") if EGRESS in labels else for_group(bridge)
    return Network(name, dict(labels), subnet, bridge, rules)


def _read(seen: Mapping[str, Any]) -> Network:
    return _network(seen["Name"], seen["Labels"], seen["IPAM"]["Config"][0]["Subnet"])


def _create(api: docker.APIClient, network: Network) -> None:
    try:
        if _read(api.inspect_network(network.name)) == network:
            return
        api.remove_network(network.name)  # of an earlier group or environment of this name
    except NotFound:
        pass
    internal = EGRESS not in network.labels
    api.create_network(
        network.name,
        driver="bridge",
        options={BRIDGE: network.bridge, **(WITHIN if internal else {})},
        ipam=IPAMConfig(pool_configs=[IPAMPool(subnet=network.subnet)]),
        check_duplicate=True,
        internal=internal,
        labels=network.labels,
    )


def _remove(api: docker.APIClient, name: str) -> str:
    """Its bridge; empty if there is no such network."""
    try:
        bridge = _read(api.inspect_network(name)).bridge
        api.remove_network(name)
    except NotFound:
        return ""
    return bridge

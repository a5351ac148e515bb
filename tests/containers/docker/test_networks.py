"""Networks of environments under Docker: their creation, packet filter rules, adoption and removal."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable
from ipaddress import IPv4Network
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pytest
from msgspec.structs import replace
from twisted.internet.base import ReactorBase

from tests.support.containers.engine_contract import Endings, PausedLaunch, opened

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker import firewall
from containers.docker import networks as module
from containers.docker.engine import DockerEngine
from containers.docker.networks import identity
from containers.settings import EGRESS_POOL, NAMESERVERS
from rce.control.calls.environments import EnvironmentSpec, Group
from rce.errors import StartFailed
from rce.protocol.messages import ContainerData
from tests.support.containers.docker_world import DockerWorld

if TYPE_CHECKING:
    from tests.support.island import Island

STAND_IN = "rce-test/stand-in:latest"
SUBNET = "10.128.77.0/24"


@pytest.fixture(scope="module")
def image(island: Island, load_stand_in: Callable[[str], None]) -> str:
    load_stand_in(island.host)
    return STAND_IN


@pytest.fixture
async def world(island: Island, image: str, tmp_path: Path, reactor: ReactorBase) -> AsyncIterator[DockerWorld]:
    with island.inside():
        yield DockerWorld(tmp_path, image, reactor)


@pytest.fixture
async def engine(world: DockerWorld) -> AsyncIterator[DockerEngine]:
    async with opened(world.engine(Endings())) as engine:
        yield engine
    assert world.remains() == set()
    assert networks(world) == {}
    assert rules() == []


def member(name: str, host: int, subnet: str = SUBNET, group: str = "fleet") -> EnvironmentSpec:
    user = name.partition("/")[0]
    address = subnet.replace("0/24", str(host))
    options = ContainerData(group=group)
    return EnvironmentSpec(
        name, 2 * identity(name, subnet), "token", options, Group(f"{user}/{group}", subnet, address)
    )


def networks(world: DockerWorld) -> dict[str, dict[str, Any]]:
    """Return the networks of this test by their group or environment."""
    found = world.api.networks(filters={"label": f"rce.directory={world.directory}"})
    labels = [each["Labels"] for each in found]
    return {own.get("rce.group") or own["rce.environment"]: each for own, each in zip(labels, found, strict=True)}


def rules() -> list[str]:
    """Return the packet filter rules of environments, by network: the order of networks does not matter."""
    lines = [line for line in output("iptables", "-S").splitlines() if "--comment rce-" in line]
    return sorted(lines, key=lambda line: line.partition("--comment ")[2].split()[0])


def output(*command: str) -> str:
    """Run a command in this thread, which is in the island's network, unlike other threads; return its output."""
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


async def test_group_network_exists_while_it_has_members(world: DockerWorld, engine: DockerEngine) -> None:
    await asyncio.gather(engine.start(member("ann/a", 2)), engine.start(member("ann/b", 9)))
    await engine.start(member("bob/a", 2, "10.128.78.0/24"))
    assert set(networks(world)) == {"ann/fleet", "bob/fleet"}
    (network,) = world.inspect("ann/b")["NetworkSettings"]["Networks"].values()
    assert (network["IPAddress"], network["IPPrefixLen"]) == ("10.128.77.9", 24)
    assert "b" in network["Aliases"]
    await engine.stop("ann/a")
    assert set(networks(world)) == {"ann/fleet", "bob/fleet"}
    await engine.stop("ann/b")
    assert set(networks(world)) == {"bob/fleet"}


async def test_host_is_not_reachable_from_a_group_network(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    bridge = networks(world)["ann/fleet"]["Options"]["com.docker.network.bridge.name"]
    assert "inet " not in output("ip", "address", "show", "dev", bridge)
    assert f"-A INPUT -i {bridge} -m comment --comment {bridge} -j DROP" in rules()


async def test_flushed_rules_are_restored(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    before = rules()
    output("iptables", "-F", "INPUT")
    assert rules() != before
    engine._on_resumed()  # as after a restart of Docker
    async with asyncio.timeout(60):
        while rules() != before:  # noqa: ASYNC110
            await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    "flush", [["-F"], ["-F", "DOCKER-USER"], ["-D", "FORWARD", "-j", "DOCKER-USER"]], ids=["all", "chain", "jump"]
)
async def test_rules_flushed_by_another_program_are_restored_within_seconds(
    world: DockerWorld, monkeypatch: pytest.MonkeyPatch, flush: list[str]
) -> None:
    monkeypatch.setattr(module, "CHECK_INTERVAL", 0.05)
    async with opened(world.engine(Endings())) as engine:
        await engine.start(replace(member("ann/a", 2), egress="internet"))
        before, jump = rules(), "-A FORWARD -j DOCKER-USER"
        output("iptables", *flush)
        async with asyncio.timeout(60):
            while rules() != before or jump not in output("iptables", "-S", "FORWARD"):  # noqa: ASYNC110
                await asyncio.sleep(0.05)


async def test_group_members_are_adopted(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    await engine.start(member("ann/b", 3))
    await engine.close()
    async with opened(world.engine(Endings())) as again:
        await again.stop("ann/a")
        assert set(networks(world)) == {"ann/fleet"}
        await again.stop("ann/b")
        assert networks(world) == {}


async def test_networks_left_by_a_crash_are_removed(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    (container,) = world.containers()
    await engine.close()
    await asyncio.to_thread(world.api.remove_container, container["Id"], force=True)
    assert set(networks(world)) == {"ann/fleet"}
    async with opened(world.engine(Endings())):
        assert networks(world) == {}
        assert rules() == []


async def test_cancelled_start_leaves_no_network(world: DockerWorld, engine: DockerEngine) -> None:
    paused = PausedLaunch(engine)
    starting = asyncio.create_task(engine.start(member("ann/a", 2)))
    await paused.reached.wait()
    assert set(networks(world)) == {"ann/fleet"}
    await engine.stop("ann/a")
    with pytest.raises(StartFailed):
        await starting
    assert networks(world) == {}


async def test_group_network_is_replaced_if_its_subnet_changes(world: DockerWorld, engine: DockerEngine) -> None:
    first = member("ann/a", 2)
    await engine.start(first)
    other = member("ann/a", 2, "10.128.99.0/24")
    await engine.start(other)
    assert networks(world)["ann/fleet"]["IPAM"]["Config"][0]["Subnet"] == "10.128.99.0/24"
    with pytest.raises(StartFailed, match="ann/b"):
        await engine.start(member("ann/b", 3))  # its group still has the other subnet


async def test_each_environment_has_its_own_egress_network(world: DockerWorld, engine: DockerEngine) -> None:
    grouped = replace(member("ann/b", 3), egress="all")
    await asyncio.gather(engine.start(with_egress("ann/a", "internet")), engine.start(grouped))
    assert set(networks(world)) == {"ann/a", "ann/b", "ann/fleet"}
    subnets = {name: IPv4Network(each["IPAM"]["Config"][0]["Subnet"]) for name, each in networks(world).items()}
    assert str(subnets.pop("ann/fleet")) == SUBNET
    assert len(set(subnets.values())) == 2
    assert all(subnet.prefixlen == 30 and subnet.subnet_of(IPv4Network(EGRESS_POOL)) for subnet in subnets.values())
    seen = world.inspect("ann/b")["NetworkSettings"]["Networks"]
    assert {each["IPAddress"] for each in seen.values()} >= {"10.128.77.3"}
    assert world.inspect("ann/a")["HostConfig"]["Dns"] == list(NAMESERVERS)
    await engine.stop("ann/a")
    await engine.stop("ann/b")
    assert networks(world) == {}


async def test_egress_network_is_adopted(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(with_egress("ann/a", "internet"))
    before = rules()
    await engine.close()
    async with opened(world.engine(Endings())) as again:
        assert sorted(rules()) == sorted(before)
        await again.stop("ann/a")
        assert networks(world) == {}


async def test_start_with_egress_fails_without_a_packet_filter(
    world: DockerWorld, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firewall, "PATH", "/nonexistent")
    with pytest.raises(StartFailed, match=r"ann/a did not start.*no iptables: install it"):
        await engine.start(with_egress("ann/a", "internet"))
    assert world.remains() == set()
    monkeypatch.undo()
    await engine.stop("ann/a")
    assert networks(world) == {}


async def test_second_removal_waits_for_the_one_under_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """The agent of a node sees that a container is gone, and is told to remove its environment."""
    removing, removed = asyncio.Event(), asyncio.Event()

    async def call(work: object) -> str:
        removing.set()
        await removed.wait()
        return ""

    networks = module.Networks(cast(module.DockerCall, call), {"rce.platform": "machine"}, EGRESS_POOL, NAMESERVERS)
    networks._members["fleet"] = {"ann/a"}
    first = asyncio.create_task(networks.leave("ann/a"))
    await removing.wait()
    second = asyncio.create_task(networks.leave("ann/a"))
    await asyncio.sleep(0)
    assert not second.done()
    removed.set()
    await asyncio.gather(first, second)
    assert networks._members == {}


def with_egress(name: str, egress: str) -> EnvironmentSpec:
    return EnvironmentSpec(name, 2 * identity(name), "token", ContainerData(), egress=egress)

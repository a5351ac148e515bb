"""Networks of environments under Docker: made with their first member, gone with their last, and guarded meanwhile."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from engine_contract import Endings, Held
from msgspec.structs import replace
from twisted.internet.base import ReactorBase

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from docker_world import DockerWorld

from containers import firewall
from containers.docker import DockerEngine
from containers.docker_networks import identity
from containers.settings import NAMESERVERS
from rce.calls.environments import Egress, EnvironmentSpec, Group
from rce.errors import StartFailed
from rce.messages import ContainerData

if TYPE_CHECKING:
    from island import Island

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
    engine = world.engine(Endings())
    await engine.open()
    yield engine
    await engine.keep([])
    await engine.close()
    assert world.there() == set()
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
    """Ours, by the group, or the environment that reaches out."""
    found = world.api.networks(filters={"label": f"rce.directory={world.directory}"})
    labels = [each["Labels"] for each in found]
    return {own.get("rce.group") or own["rce.environment"]: each for own, each in zip(labels, found, strict=True)}


def rules() -> list[str]:
    """Those of environments, Docker's own apart."""
    return [line for line in said("iptables", "-S").splitlines() if "--comment rce-" in line]


def said(*command: str) -> str:
    """In this thread, as it is in the island's network and others are not."""
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


async def test_a_group_network_is_there_from_its_first_member_to_its_last(
    world: DockerWorld, engine: DockerEngine
) -> None:
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


async def test_the_host_has_no_address_in_it_and_takes_nothing_from_it(
    world: DockerWorld, engine: DockerEngine
) -> None:
    await engine.start(member("ann/a", 2))
    bridge = networks(world)["ann/fleet"]["Options"]["com.docker.network.bridge.name"]
    assert "inet " not in said("ip", "address", "show", "dev", bridge)
    assert f"-A INPUT -i {bridge} -m comment --comment {bridge} -j DROP" in rules()


async def test_rules_that_others_removed_come_back(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    before = rules()
    said("iptables", "-F", "INPUT")
    assert rules() != before
    engine._taken_up()  # as when Docker was restarted
    async with asyncio.timeout(10):
        while rules() != before:  # noqa: ASYNC110
            await asyncio.sleep(0.05)


async def test_members_are_adopted(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    await engine.start(member("ann/b", 3))
    await engine.close()
    again = world.engine(Endings())
    await again.open()
    await again.stop("ann/a")
    assert set(networks(world)) == {"ann/fleet"}
    await again.stop("ann/b")
    assert networks(world) == {}
    await again.close()


async def test_what_a_crash_left_is_removed(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(member("ann/a", 2))
    (container,) = world.containers()
    await engine.close()
    await asyncio.to_thread(world.api.remove_container, container["Id"], force=True)
    assert set(networks(world)) == {"ann/fleet"}
    again = world.engine(Endings())
    await again.open()
    assert networks(world) == {}
    assert rules() == []
    await again.close()


async def test_a_start_that_is_cancelled_leaves_no_network(world: DockerWorld, engine: DockerEngine) -> None:
    held = Held(engine)
    starting = asyncio.create_task(engine.start(member("ann/a", 2)))
    await held.reached.wait()
    assert set(networks(world)) == {"ann/fleet"}
    await engine.stop("ann/a")
    with pytest.raises(StartFailed):
        await starting
    assert networks(world) == {}


async def test_a_group_that_comes_again_with_another_subnet(world: DockerWorld, engine: DockerEngine) -> None:
    first = member("ann/a", 2)
    await engine.start(first)
    other = member("ann/a", 2, "10.128.99.0/24")
    await engine.start(other)
    assert networks(world)["ann/fleet"]["IPAM"]["Config"][0]["Subnet"] == "10.128.99.0/24"
    with pytest.raises(StartFailed, match="ann/b"):
        await engine.start(member("ann/b", 3))  # ann/a is in the way


async def test_each_environment_that_reaches_out_has_a_network_of_its_own(
    world: DockerWorld, engine: DockerEngine
) -> None:
    grouped = replace(member("ann/b", 3), egress="all")
    await asyncio.gather(engine.start(reaching("ann/a", "internet")), engine.start(grouped))
    assert set(networks(world)) == {"ann/a", "ann/b", "ann/fleet"}
    subnets = {each["IPAM"]["Config"][0]["Subnet"] for each in networks(world).values()}
    assert subnets == {SUBNET, "10.127.0.0/30", "10.127.0.4/30"}
    seen = world.inspect("ann/b")["NetworkSettings"]["Networks"]
    assert {each["IPAddress"] for each in seen.values()} >= {"10.128.77.3"}
    assert world.inspect("ann/a")["HostConfig"]["Dns"] == list(NAMESERVERS)
    await engine.stop("ann/a")
    await engine.stop("ann/b")
    assert networks(world) == {}


async def test_a_network_to_reach_out_by_is_adopted(world: DockerWorld, engine: DockerEngine) -> None:
    await engine.start(reaching("ann/a", "internet"))
    before = rules()
    await engine.close()
    again = world.engine(Endings())
    await again.open()
    assert sorted(rules()) == sorted(before)
    await again.stop("ann/a")
    assert networks(world) == {}
    await again.close()


async def test_without_a_packet_filter_nobody_reaches_out(
    world: DockerWorld, engine: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firewall, "PATH", "/nonexistent")
    with pytest.raises(StartFailed, match=r"ann/a did not start.*no iptables: install it"):
        await engine.start(reaching("ann/a", "internet"))
    assert world.there() == set()
    monkeypatch.undo()
    await engine.stop("ann/a")
    assert networks(world) == {}


def reaching(name: str, egress: Egress) -> EnvironmentSpec:
    return EnvironmentSpec(name, 2 * identity(name), "token", ContainerData(), egress=egress)

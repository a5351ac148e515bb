# ruff: noqa: E402  (imports after importorskip)
"""The platform with the engine `swarm` on three machines, of which one is drained, disconnected or loses its Docker.

The first machine is the swarm's manager. The others have the special feature `cloud`, so environments are placed there.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from rce.api.http import EntryClient, basic
from tests.support.e2e.machines import Host, Machines
from tests.support.e2e.mapping import rce_map
from tests.support.e2e.real_platform import until
from tests.support.e2e.traffic import Echo
from tests.support.swarm_nodes import HOST_IMAGE, Node, Swarm, host_mounts, load_host_image, swarm_of

STRING = "std_msgs/String"
MOVE_TIMEOUT = 120.0
REACH = """
import socket
try:
    socket.create_connection(("{address}", 22), 3)
except OSError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def swarm() -> Iterator[Swarm]:
    with swarm_of(3) as made:
        load_host_image(made.nodes[0], mapping=True)  # the others pull it from there
        for node in made.nodes[1:]:
            label(made, node, {"rce.feature.cloud": "true"}, "active")
        before = os.environ.get("DOCKER_HOST")
        os.environ["DOCKER_HOST"] = made.nodes[0].host
        yield made
        os.environ.pop("DOCKER_HOST")
        if before is not None:
            os.environ["DOCKER_HOST"] = before


def label(swarm: Swarm, node: Node, labels: dict[str, str], availability: str) -> None:
    manager = swarm.nodes[0].api()
    id = node.api().info()["Swarm"]["NodeID"]
    role = "manager" if node is swarm.nodes[0] else "worker"
    changed = False
    while not changed:
        version = manager.inspect_node(id)["Version"]["Index"]
        try:
            changed = manager.update_node(id, version, {"Role": role, "Labels": labels, "Availability": availability})
        except docker.errors.APIError as error:
            if "update out of sequence" not in str(error):  # else Swarm has changed the node meanwhile
                raise


@pytest.fixture(scope="module")
async def platform(
    swarm: Swarm, arguments: list[str], tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[Machines]:
    words = [f"{option}={value}" for option, value in zip(arguments[::2], arguments[1::2], strict=True)]
    words += ["--engine=swarm", f"--image={HOST_IMAGE}", f"--agent-image={HOST_IMAGE}"]
    words += [f"--agent-address={swarm.address}", f"--mounts={','.join(host_mounts())}"]
    master = Host("master", swarm.address)
    async with Machines(tmp_path_factory.mktemp("platform"), master, [Host("here")], words, 10) as made:
        yield made
    assert not containers(swarm), "containers were not removed"


def containers(swarm: Swarm) -> dict[str, Node]:
    """Return the node of each running environment by its tag."""
    return {tag: node for node in swarm.nodes if node.process.poll() is None for tag in tags(node)}


def tags(node: Node) -> list[str]:
    """Return the tags of the environments that run on a node."""
    found = node.api().containers(filters={"label": "rce.environment"})
    return [each["Labels"]["rce.environment"].partition("/")[2] for each in found]


def relayed(url: str) -> dict[str, float]:
    """Return the bytes that have passed the relays of the swarm's task set and its agents, by node."""
    with EntryClient(url, basic("admin", "admin")).open("GET", "metrics/container-here") as answer:
        families = text_string_to_metric_families(answer.read().decode())
    (family,) = (each for each in families if each.name == "rce_relay_bytes")
    return {sample.labels["node"]: sample.value for sample in family.samples}


async def test_environments_move_from_a_drained_machine(swarm: Swarm, platform: Machines) -> None:
    """A message passes from the robot to nodes in two environments and back, before and after they share a machine."""
    async with (
        platform.robot("r1") as robot,
        robot.environment("one", special_features=["cloud"]) as one,
        robot.environment("two", special_features=["cloud"]) as two,
    ):
        for environment in (one, two):
            await environment.add_node("echo", "rce_demo", "echo.py")
        await robot.add_interface("one", "out", "SubscriberInterface", STRING, addr="/heard")
        await robot.add_interface("two", "in", "PublisherInterface", STRING, addr="/say")
        await robot.connect("one/out", "two/in")
        chain = Echo(await one.publisher("/say", STRING), await two.subscriber("/heard", STRING))
        await chain.answers()
        before = containers(swarm)
        assert before["one"] is not before["two"], "Swarm spreads them"
        relayed_bytes: dict[str, float] = {}
        async with asyncio.timeout(60):
            while len(relayed_bytes) < 4:  # an agent on a busy machine may not answer in time
                relayed_bytes = await asyncio.to_thread(relayed, platform.master.ready["url"])
        assert len(relayed_bytes) == 4, "the task set and an agent on each machine"
        ids = [before[tag].api().info()["Swarm"]["NodeID"] for tag in ("one", "two")]
        assert min(relayed_bytes[id] for id in ids) > 0
        label(swarm, before["two"], {"rce.feature.cloud": "true"}, "drain")
        await until(lambda: containers(swarm).get("two") is before["one"], MOVE_TIMEOUT)
        await chain.answers(MOVE_TIMEOUT)
    label(swarm, before["two"], {"rce.feature.cloud": "true"}, "active")
    await until(lambda: not volumes(before["two"]), MOVE_TIMEOUT)  # removed when its agent runs again


async def test_group_is_one_ros_graph_over_two_machines(platform: Machines, swarm: Swarm) -> None:
    """A node in one environment answers messages from the other, and each resolves the name of the other."""
    async with (
        platform.robot("r2") as robot,
        robot.environment("left", special_features=["cloud"], group="pair", group_ip="192.168.1.9") as left,
        robot.environment("right", special_features=["cloud"], group="pair") as right,
    ):
        nodes = containers(swarm)
        assert nodes["left"] is not nodes["right"], "Swarm spreads them"
        await right.add_node("echo", "rce_demo", "echo.py")
        await Echo(await left.publisher("/say", STRING), await left.subscriber("/heard", STRING)).answers()
        name = "import socket; print(socket.gethostbyname('{}'))"
        address = run_in(nodes["right"], "right", name.format("left")).strip()
        assert address.endswith(".9"), address
        assert run_in(nodes["left"], "left", name.format("left")).strip() == address
        assert run_in(nodes["left"], "left", name.format("right")).startswith(address[:-1])
        for address in (swarm.address, nodes["left"].address, "169.254.169.254"):
            assert "unreachable" in run_in(nodes["left"], "left", REACH.format(address=address))
    manager = swarm.nodes[0].api()
    await until(lambda: not manager.networks(filters={"label": "rce.directory"}), what="its network is removed")


def run_in(node: Node, tag: str, program: str) -> str:
    api = node.api()
    (found,) = [
        each["Id"]
        for each in api.containers(filters={"label": "rce.environment"})
        if each["Labels"]["rce.environment"].endswith(f"/{tag}")
    ]
    call = api.exec_create(found, ["python3", "-c", program])
    output: bytes = api.exec_start(call["Id"])
    return output.decode()


def volumes(node: Node) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = node.api().volumes(filters={"label": "rce.directory"})["Volumes"] or []
    return found


async def test_map_is_made_on_the_swarm(platform: Machines, tmp_path: Path) -> None:
    """A small simulated recording, in an environment with one core and 1 GiB."""
    url = platform.master.ready["url"]
    done = await rce_map("--simulate", "--url", url, "--out", tmp_path / "map", temporary=tmp_path)
    assert done.status == 0, done.errors
    assert (tmp_path / "map" / "map.yaml").exists()


async def test_environment_moves_from_a_disconnected_machine(swarm: Swarm, platform: Machines) -> None:
    """The environment is restarted elsewhere; its old container runs on unseen and is removed on reconnection."""
    async with platform.robot("r3") as robot, robot.environment("stray", special_features=["cloud"]) as environment:
        echo = await Echo.of(environment)
        await echo.answers()
        first = containers(swarm)["stray"]
        first.cut_off()
        try:
            (other,) = (node for node in swarm.nodes[1:] if node is not first)
            await until(lambda: "stray" in tags(other), MOVE_TIMEOUT)
            await echo.answers(MOVE_TIMEOUT)
            assert "stray" in tags(first)
        finally:
            first.plug_in()
        await until(lambda: "stray" not in tags(first), MOVE_TIMEOUT)
        await echo.answers()
    await until(lambda: not volumes(first), what="its volumes are removed")


async def test_environment_moves_from_a_machine_with_a_killed_docker(swarm: Swarm, platform: Machines) -> None:
    """This is the last test of the module, as the machine is not restarted."""
    async with platform.robot("r4") as robot, robot.environment("survivor", special_features=["cloud"]) as environment:
        echo = await Echo.of(environment)
        await echo.answers()
        first = containers(swarm)["survivor"]
        await asyncio.to_thread(first.kill)
        await until(lambda: "survivor" in containers(swarm), MOVE_TIMEOUT)
        await echo.answers(MOVE_TIMEOUT)
    first.power_off()

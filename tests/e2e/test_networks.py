"""Network groups and what environments reach, with real containers and hostile programs in them.

The machine is an island (tests/island.py): its Docker uses the packet filter, and around it are a host of the internet,
one of a private network and a cloud's metadata. Each attempt that fails from one environment succeeds from another.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import AsyncIterator, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from real_platform import RCE, RealPlatform, until

pytest.importorskip("docker", reason="needs docker-py: pip install 'rce[docker]'")

import reach
from island import IN_INTERNET, IN_PRIVATE, METADATA, OWN

from rce.bench import pairs
from rce.bench.nodes import Place
from rce.client import Robot
from rce.messages import EnvironmentEvent

if TYPE_CHECKING:
    from island import Island

REACH = Path(reach.__file__).read_text()
STRING = "std_msgs/String"
LISTEN = """
import time, rclpy
rclpy.init()
node = rclpy.create_node("looker")
time.sleep(4)
print([name for name, _ in node.get_topic_names_and_types() if name.startswith("/secret")])
"""
SPEAK = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("speaker")
speaker = node.create_publisher(String, "/secret_" + sys.argv[1], 10)
node.create_timer(0.1, lambda: speaker.publish(String(data="x")))
print("speaking", flush=True)
rclpy.spin(node)
"""


class Inside:
    """An environment seen from Docker."""

    def __init__(self, api: Any, container: dict[str, Any]) -> None:
        self._api = api
        self.id = container["Id"]
        self.tag = container["Labels"]["rce.environment"]
        networks = container["NetworkSettings"]["Networks"]
        self.addresses = {name.split("-")[1]: each["IPAddress"] for name, each in networks.items() if "-" in name}

    async def run(self, program: str, *words: str, **environment: str) -> str:
        """What a program prints."""
        call = self._api.exec_create(self.id, ["python3", "-c", program, *words], environment=environment)
        output: bytes = await asyncio.to_thread(self._api.exec_start, call["Id"])
        return output.decode()

    def begin(self, program: str, *words: str, **environment: str) -> None:
        """It runs until the container ends."""
        call = self._api.exec_create(self.id, ["python3", "-c", program, *words], environment=environment)
        self._api.exec_start(call["Id"], detach=True)

    async def reached(self, *targets: tuple[str, str, int]) -> set[tuple[str, str]]:
        """Kind and address of each who answered."""
        answers = json.loads(await self.run(REACH, "try", json.dumps(targets)))
        return {(kind, who) for kind, _, _, all_who in answers for who in all_who}


@pytest.fixture(scope="module")
def inside(island: Island, request: pytest.FixtureRequest) -> Iterator[Any]:
    """Docker's API on the island, where this thread is from now on; its images are those of the usual daemon."""
    import docker

    from provisioning.image import MAPPING
    from rce import __version__

    api = docker.APIClient(base_url=island.host, version="auto", timeout=600)
    if not island.kept:
        images = request.getfixturevalue("images")
        api.load_image(images.get_image(f"{MAPPING}:{__version__}"))
    with island.inside():
        yield api
    api.close()


@pytest.fixture(scope="module")
async def platform(inside: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """Its users are named for what their environments reach; `wide` reaches all."""
    directory = tmp_path_factory.mktemp("networked")
    (directory / "data" / "master").mkdir(parents=True)
    for user, egress in (("ann", "none"), ("bob", "none"), ("net", "internet"), ("wide", "all")):
        rce_user(directory, "add", user, given=f"{user}\n")
        rce_user(directory, "limits", user, f"egress={egress}")
    platform = RealPlatform(directory, "--engine", "docker", "--host", "0.0.0.0", "--size", "12", dev=False)
    await platform.start()
    yield platform
    await platform.stop()
    label = f"rce.directory={directory / 'data' / 'container'}"
    assert not inside.containers(all=True, filters={"label": label})
    assert not inside.networks(filters={"label": label})
    assert "--comment rce-" not in subprocess.check_output(["iptables", "-S"], text=True)


def rce_user(directory: Path, *words: str, given: str = "") -> None:
    command = [RCE, "user", "--data-dir", str(directory / "data" / "master"), *words]
    subprocess.run(command, input=given, text=True, check=True, stdout=subprocess.DEVNULL)


def robot(platform: RealPlatform, user: str, name: str) -> Robot:
    return Robot(platform.url, user=user, robot=name, password=user, timeout=90)


def seen(api: Any, platform: RealPlatform) -> dict[str, Inside]:
    label = f"rce.directory={platform.directory / 'data' / 'container'}"
    found = (Inside(api, each) for each in api.containers(filters={"label": label}))
    return {each.tag: each for each in found}


async def test_a_group_is_one_ros_graph(platform: RealPlatform) -> None:
    """Topics of 10 B and of 1 MB, and services, between nodes of two environments without any connection."""
    async with (
        robot(platform, "ann", "r1") as ann,
        ann.environment("bench", restart="no") as environment,
        AsyncExitStack() as stack,
    ):
        for probe in await pairs.group(Place(ann, environment, stack)):
            for size in (10, 1_000_000):
                assert await probe.sample(size) > 0


async def test_members_know_each_other_and_later_ones_too(platform: RealPlatform, inside: Any) -> None:
    async with robot(platform, "ann", "r2") as ann:
        events = aiter(ann.events())
        first_one = ann.environment("First", group="g", group_ip="192.168.1.77")
        async with first_one, ann.environment("second", group="g") as second:
            containers = seen(inside, platform)
            first = containers["ann/First"]
            assert first.addresses["group"].endswith(".77")
            name = "import socket, sys; print(socket.gethostbyname(sys.argv[1]))"
            assert (await first.run(name, "second")).strip() == containers["ann/second"].addresses["group"]
            assert (await containers["ann/second"].run(name, "First")).strip() == first.addresses["group"]
            # A robot hears, by an interface of one environment, a node of the other, which is a second one's echo.
            await first_one.add_node("echo", "rce_demo", "echo.py")
            heard = await second.subscriber("/heard", STRING)
            say = await second.publisher("/say", STRING)
            async with asyncio.timeout(30):
                await say.publish({"data": "to the other"})
                assert await anext(aiter(heard)) == {"data": "to the other"}
        async with asyncio.timeout(10):
            ready = await anext(events)
        assert ready == EnvironmentEvent("First", "ready", address=first.addresses["group"])


async def test_what_hostile_nodes_reach(platform: RealPlatform, inside: Any, island: Island) -> None:
    everybody = {
        "ann": {"a1": "fleet", "a2": "fleet", "b1": "other"},
        "bob": {"victim": "fleet"},
        "net": {"n1": "fleet", "n2": ""},
        "wide": {"w1": ""},
    }
    servers = [
        await asyncio.create_subprocess_exec(*words, "python3", "-c", REACH, "serve", stdout=asyncio.subprocess.PIPE)
        for words in ((), ("ip", "netns", "exec", island.world))
    ]
    async with AsyncExitStack() as stack:
        for server in servers:
            stack.callback(server.kill)
        for user, environments in everybody.items():
            its = await stack.enter_async_context(robot(platform, user, "hostile"))
            for tag, group in environments.items():
                await stack.enter_async_context(its.environment(tag, group=group, restart="no"))
        here = seen(inside, platform)
        for each in here.values():
            each.begin(REACH, "serve")
        await until(lambda: all(is_served(each, inside) for each in here.values()), what="all serve")
        await check_groups(here)
        await check_machine(here, platform, island)
        await check_egress(here)
        await check_discovery(here)
        await check_data_ports(here["ann/a1"])


def is_served(inside: Inside, api: Any) -> bool:
    return "'serve'" in str(api.top(inside.id, "-eo args")["Processes"]) or "serve" in str(api.top(inside.id))


def both(address: str) -> list[tuple[str, str, int]]:
    return [("tcp", address, reach.TCP), ("udp", address, reach.UDP)]


def answers(*addresses: str) -> set[tuple[str, str]]:
    return {(kind, address) for address in addresses for kind in ("tcp", "udp")}


async def check_groups(here: dict[str, Inside]) -> None:
    """TCP, UDP and multicast: to members of the group, and to nobody else, of one's own user or another."""
    every = [address for each in here.values() for address in each.addresses.values()]
    others = [address for address in every if address != here["ann/a1"].addresses["group"]]
    targets = [target for address in others for target in both(address)]
    member = here["ann/a2"].addresses["group"]
    assert await here["ann/a1"].reached(*targets) == answers(member)
    multicast = ("multicast", reach.GROUP, reach.MULTICAST)
    heard = await here["ann/a1"].reached(multicast)
    assert heard - {("multicast", here["ann/a1"].addresses["group"])} == {("multicast", member)}


async def check_machine(here: dict[str, Inside], platform: RealPlatform, island: Island) -> None:
    """The host at every address, and the Master's and the Robot endpoint's ports."""
    shown = json.loads(subprocess.check_output(["ip", "-4", "-j", "address"]))
    addresses = [each["local"] for device in shown for each in device["addr_info"] if device["ifname"] != "lo"]
    assert set(OWN) < set(addresses)
    entry = int(platform.url.rstrip("/").rpartition(":")[2])
    targets = [target for address in addresses for target in (*both(address), ("tcp", address, entry))]
    for attacker in ("ann/a1", "net/n1", "net/n2"):
        assert await here[attacker].reached(*targets) == set(), attacker
    assert await here["wide/w1"].reached(("tcp", OWN[0], entry), *both(OWN[0])) == answers(OWN[0])


async def check_egress(here: dict[str, Inside]) -> None:
    around = [target for address in (IN_INTERNET, IN_PRIVATE, METADATA) for target in both(address)]
    assert await here["ann/a1"].reached(*around) == set()
    assert await here["net/n1"].reached(*around) == answers(IN_INTERNET)
    assert await here["net/n2"].reached(*around) == answers(IN_INTERNET)
    assert await here["wide/w1"].reached(*around) == answers(IN_INTERNET, IN_PRIVATE, METADATA)
    assert set(here["net/n1"].addresses) == {"group", "egress"}
    for attacker, victims in (("net/n1", ["net/n2", "wide/w1", "bob/victim"]), ("wide/w1", ["net/n1", "bob/victim"])):
        addresses = [address for victim in victims for address in here[victim].addresses.values()]
        targets = [target for address in addresses for target in both(address)]
        assert await here[attacker].reached(*targets) == set(), attacker


async def check_discovery(here: dict[str, Inside]) -> None:
    """A node that asks all others by their addresses finds those of its group."""
    profile = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    for tag, each in here.items():
        each.begin(SPEAK, tag.replace("/", "_"), **profile)
    every = ";".join(address for each in here.values() for address in each.addresses.values())
    found = await here["ann/a1"].run(LISTEN, ROS_STATIC_PEERS=every, **profile)
    assert sorted(eval(found.splitlines()[-1])) == ["/secret_ann_a1", "/secret_ann_a2"]
    found = await here["wide/w1"].run(LISTEN, ROS_STATIC_PEERS=every, **profile)
    assert eval(found.splitlines()[-1]) == ["/secret_wide_w1"]


async def check_data_ports(attacker: Inside) -> None:
    """The sockets of its user's other environments say nothing to a key that was not given."""
    directory = "import os; print(os.path.dirname(os.environ['RCE_SOCKET']))"
    sockets = (await attacker.run(directory)).strip()
    said = json.loads(await attacker.run(REACH, "knock", sockets))
    assert len(said) >= 3
    assert set(said) == {""}

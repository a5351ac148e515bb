"""Network groups and egress policies, with real containers and hostile programs in them.

The machine is an island (tests/support/island.py): its Docker uses the packet filter, and connected to it are a host of
the internet, one of a private network and a cloud's metadata service. Each attempt that must fail from one environment
succeeds from another.
"""

from __future__ import annotations

import asyncio
import json
import subprocess
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.support.e2e.real_platform import RCE, RealPlatform
from tests.support.paths import ROS_PACKAGES

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from rce.bench import pairs
from rce.bench.nodes import Place
from rce.client import Robot
from rce.protocol.messages import EnvironmentEvent
from tests.support.e2e import reach
from tests.support.e2e.traffic import Echo
from tests.support.island import IN_INTERNET, IN_PRIVATE, METADATA, MPI_IMAGE, OWN

if TYPE_CHECKING:
    from tests.support.island import Island

REACH = Path(reach.__file__).read_text()
STRING = "std_msgs/String"
PACKAGES = ROS_PACKAGES
Target = tuple[str, str, int]  # kind, address, port
LISTEN = """
import json, sys, time, rclpy
rclpy.init()
node = rclpy.create_node("looker")
def topics():
    return {name for name, _ in node.get_topic_names_and_types() if name.startswith("/secret")}
end = time.monotonic() + 60
while not topics() >= set(sys.argv[1:]) and time.monotonic() < end:
    time.sleep(0.1)
time.sleep(4)  # within which others would be discovered
print(json.dumps(sorted(topics())))
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
EVERYWHERE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}


class Inside:
    """Container of an environment, accessed through Docker."""

    def __init__(self, api: Any, container: dict[str, Any]) -> None:
        self._api = api
        self.id = container["Id"]
        self.tag = container["Labels"]["rce.environment"]
        networks = container["NetworkSettings"]["Networks"]
        self.addresses = {name.split("-")[1]: each["IPAddress"] for name, each in networks.items() if "-" in name}

    async def run(self, program: str, *words: str, **environment: str) -> str:
        """Run a program in the container; return its output."""
        call = self._api.exec_create(self.id, ["python3", "-c", program, *words], environment=environment)
        output: bytes = await asyncio.to_thread(self._api.exec_start, call["Id"])
        return output.decode()

    def begin(self, program: str, *words: str, **environment: str) -> None:
        """Start a program that runs until the container ends."""
        call = self._api.exec_create(self.id, ["python3", "-c", program, *words], environment=environment)
        self._api.exec_start(call["Id"], detach=True)

    async def serve(self) -> None:
        self.begin(REACH, "serve")
        async with asyncio.timeout(120):
            while await self.reached("127.0.0.1") != set(both("127.0.0.1")):  # noqa: ASYNC110
                await asyncio.sleep(0.1)

    async def reached(self, *addresses: str, also: Sequence[Target] = ()) -> set[Target]:
        """Return the targets that answered: these addresses by TCP and UDP, and further targets."""
        targets = [*both(*addresses), *also]
        return set(map(tuple, json.loads(await self.run(REACH, "try", json.dumps(targets)))))


@pytest.fixture(scope="module")
async def inside(island: Island) -> AsyncIterator[Any]:
    """Docker's API on the island; this thread is moved to the island's network."""
    import docker

    api = docker.APIClient(base_url=island.host, version="auto", timeout=600)
    with island.inside():
        yield api
    api.close()


@pytest.fixture(scope="module")
async def platform(inside: Any, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[RealPlatform]:
    """Platform on the island; users `net` and `wide` may reach the internet and everything, the others nothing."""
    directory = tmp_path_factory.mktemp("networked")
    (directory / "data" / "master").mkdir(parents=True)
    for user, egress in (("ann", "none"), ("bob", "none"), ("net", "internet"), ("wide", "all")):
        rce_user(directory, "add", "--create", user, given=f"{password(user)}\n")
        if egress != "none":
            rce_user(directory, "limits", user, f"egress={egress}")
    rce_user(directory, "limits", "ann", f"images={MPI_IMAGE}")
    words = ["--engine", "docker", "--host", "0.0.0.0", "--size", "12", "--package-path", str(PACKAGES)]
    async with RealPlatform(directory, *words, dev=False) as platform:
        yield platform
    label = f"rce.directory={directory / 'data' / 'container'}"
    assert not inside.containers(all=True, filters={"label": label})
    assert not inside.networks(filters={"label": label})
    assert "--comment rce-" not in output("iptables", "-w", "-S")


def rce_user(directory: Path, *words: str, given: str = "") -> None:
    command = [RCE, "user", "--data-dir", str(directory / "data" / "master"), *words]
    subprocess.run(command, input=given, text=True, check=True, stdout=subprocess.DEVNULL)


def password(user: str) -> str:
    return f"{user} and its robots"


def output(*command: str) -> str:
    """Run a command in this thread, which is on the island; return its output."""
    return subprocess.check_output(command, text=True)


def robot(platform: RealPlatform, user: str, name: str) -> Robot:
    return Robot(platform.url, user=user, robot=name, password=password(user), timeout=120)


def seen(api: Any, platform: RealPlatform) -> dict[str, Inside]:
    label = f"rce.directory={platform.directory / 'data' / 'container'}"
    found = (Inside(api, each) for each in api.containers(filters={"label": label}))
    return {each.tag: each for each in found}


async def test_group_is_one_ros_graph(platform: RealPlatform) -> None:
    """Nodes of two environments share topics (10 B and 1 MB) and services without connections of the platform."""
    async with (
        robot(platform, "ann", "r1") as ann,
        ann.environment("bench", restart="no") as environment,
        AsyncExitStack() as stack,
    ):
        for probe in await pairs.group(Place(ann, environment, stack)):
            for size in (10, 1_000_000):
                assert await probe.sample(size) > 0


async def test_members_resolve_each_other_and_later_members(platform: RealPlatform, inside: Any) -> None:
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
            # A node in the first environment echoes what the robot publishes and receives through the second.
            await first_one.add_node("echo", "rce_demo", "echo.py")
            await Echo(await second.publisher("/say", STRING), await second.subscriber("/heard", STRING)).answers()
        async with asyncio.timeout(60):
            ready = await anext(events)
        assert ready == EnvironmentEvent("First", "ready", address=first.addresses["group"])


async def test_open_mpi_runs_over_a_group_of_three(platform: RealPlatform, inside: Any) -> None:
    if not inside.images(MPI_IMAGE):
        pytest.skip(f"the kept daemon has no {MPI_IMAGE}, which is built from tests/ros/Mpi/image/Dockerfile")
    async with robot(platform, "ann", "r3") as ann, AsyncExitStack() as stack:
        made = [
            stack.enter_async_context(ann.environment(tag, group="mpi", image=MPI_IMAGE)) for tag in ("m1", "m2", "m3")
        ]
        first, *others = await asyncio.gather(*made)
        for each in others:
            await each.add_node("member", "Mpi", "member.py")
        result = await first.subscriber("/mpi", STRING)
        await first.add_node("launch", "Mpi", "launch.py", args="m1 m2 m3")
        async with asyncio.timeout(120):
            assert await anext(aiter(result)) == {"data": "sum 6 of 3 ranks on m1 m2 m3"}


async def test_hostile_nodes_reach_only_what_is_allowed(platform: RealPlatform, inside: Any, island: Island) -> None:
    users = {
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
            assert server.stdout is not None
            assert await asyncio.wait_for(server.stdout.readline(), 60) == b"serving\n"
        made = [
            stack.enter_async_context(its.environment(tag, group=group, restart="no"))
            for user, environments in users.items()
            for its in [await stack.enter_async_context(robot(platform, user, "hostile"))]
            for tag, group in environments.items()
        ]
        await asyncio.gather(*made)
        here = seen(inside, platform)
        await asyncio.gather(*(each.serve() for each in here.values()))
        await check_groups(here)
        for tag, each in here.items():
            each.begin(SPEAK, tag.replace("/", "_"), **EVERYWHERE)
        await check_machine(here, platform)
        await check_egress(here)
        await check_discovery(here)
        await check_data_ports(here["ann/a1"])


def both(*addresses: str) -> list[Target]:
    ports = (("tcp", reach.TCP), ("udp", reach.UDP))
    return [(kind, address, port) for address in addresses for kind, port in ports]


def addresses(*environments: Inside) -> list[str]:
    return [address for each in environments for address in each.addresses.values()]


async def check_groups(here: dict[str, Inside]) -> None:
    """TCP, UDP and multicast reach members of the group and no other environment, of the same user or another."""
    own, member = here["ann/a1"].addresses["group"], here["ann/a2"].addresses["group"]
    others = [address for address in addresses(*here.values()) if address != own]
    to_all = ("multicast", reach.GROUP, reach.MULTICAST)
    heard = await here["ann/a1"].reached(*others, also=[to_all])
    assert heard - {("multicast", own, reach.MULTICAST)} == {*both(member), ("multicast", member, reach.MULTICAST)}


async def check_machine(here: dict[str, Inside], platform: RealPlatform) -> None:
    """The host is not reachable at any address, nor are the ports of the Master and the Robot endpoint."""
    devices = json.loads(output("ip", "-4", "-j", "address"))
    every = [each["local"] for device in devices for each in device["addr_info"] if device["ifname"] != "lo"]
    assert set(OWN) < set(every)
    entry = int(platform.url.rstrip("/").rpartition(":")[2])
    entries: list[Target] = [("tcp", address, entry) for address in every]
    attackers = ("ann/a1", "net/n1", "net/n2")
    found = await asyncio.gather(*(here[each].reached(*every, also=entries) for each in attackers))
    assert list(found) == [set(), set(), set()]
    assert await here["wide/w1"].reached(*every, also=entries) >= {*both(OWN[0]), ("tcp", OWN[0], entry)}


async def check_egress(here: dict[str, Inside]) -> None:
    """A group alone reaches nothing outside; egress follows the user's policy, and never reaches other environments."""
    outside = (IN_INTERNET, IN_PRIVATE, METADATA)
    sources = ("ann/a1", "net/n1", "net/n2", "wide/w1")
    found = await asyncio.gather(*(here[each].reached(*outside) for each in sources))
    internet = set(both(IN_INTERNET))
    assert list(found) == [set(), internet, internet, set(both(*outside))]
    assert set(here["net/n1"].addresses) == {"group", "egress"}
    net, other, wide, victim = (here[each] for each in ("net/n1", "net/n2", "wide/w1", "bob/victim"))
    assert await net.reached(*addresses(other, wide, victim)) == set()
    assert await wide.reached(*addresses(net, other, victim)) == set()


async def check_discovery(here: dict[str, Inside]) -> None:
    """A node that is configured with the addresses of all others discovers only those of its group."""
    profile = EVERYWHERE | {"ROS_STATIC_PEERS": ";".join(addresses(*here.values()))}
    expected = {"ann/a1": ["/secret_ann_a1", "/secret_ann_a2"], "wide/w1": ["/secret_wide_w1"]}
    found = await asyncio.gather(*(here[each].run(LISTEN, *topics, **profile) for each, topics in expected.items()))
    assert [json.loads(each.splitlines()[-1]) for each in found] == [*expected.values()]


async def check_data_ports(attacker: Inside) -> None:
    """The sockets of its user's other environments do not answer to an unknown key."""
    directory = "import os; print(os.path.dirname(os.environ['RCE_SOCKET']))"
    sockets = (await attacker.run(directory)).strip()
    answers = json.loads(await attacker.run(REACH, "knock", sockets))
    assert len(answers) >= 3
    assert set(answers) == {""}

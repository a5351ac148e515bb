"""Killed participants, with real processes of ROS 2."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from endpoints.environment.dead_participants import farewell
from rce.control.calls.endpoints import NodeSpec, StartNode, StopNode
from rce.control.calls.watching import ReadGraph
from rce.protocol.messages import Qos
from tests.support.domains import domain
from tests.support.endpoints.environment_driver import LIMIT, FakeMaster

TALKER = """
import time, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/farewell", 10)
print("up", flush=True)
time.sleep(100)
"""
OBSERVER = """
import subprocess, sys, time, rclpy
from endpoints.environment.dead_participants import tell_of_dead

def until(condition, limit=60):
    deadline = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < deadline, f"not within {limit} s"
        time.sleep(0.01)

rclpy.init()
node = rclpy.create_node("observer")
infos = lambda topic: node.get_publishers_info_by_topic(topic)
tell = lambda: tell_of_dead(node, bytes(infos("/rosout")[0].endpoint_gid[:12]), ["127.0.0.1"])
until(lambda: infos("/rosout"))
talker = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
try:
    talker.stdout.readline()
    until(lambda: infos("/farewell"))
    assert tell() == 0, "it runs"
    assert infos("/farewell")
finally:
    talker.kill()
    talker.wait()
assert tell() == 1
until(lambda: not infos("/farewell"), 15)  # less than the lease
until(lambda: tell() == 0)  # its other endpoints go one after the other
"""


def test_killed_participant_is_removed_at_once() -> None:
    """Without the message it stays for the 20 s of its lease.

    The processes have a network of their own: Fast DDS derives the id of the host from its addresses, and other tests
    add and remove networks meanwhile. Shared memory is that of the machine, hence the domain.
    """
    separate = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]
    network = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
    environ = os.environ | {"ROS_DOMAIN_ID": str(domain("farewell")), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command = [*separate, *network, sys.executable, "-c", OBSERVER, TALKER]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr


async def test_messages_after_the_death_of_a_node_wait_for_its_successor(master: FakeMaster) -> None:
    place = f"killed_{secrets.token_hex(8)}"  # by which its process is found
    node = NodeSpec("killed", "probe", "echo.py", namespace=place)
    qos = Qos(durability="volatile")
    there = await master.interface("PublisherInterface", "std_msgs/String", f"/{place}/there", qos)
    back = await master.interface("SubscriberInterface", "std_msgs/String", f"/{place}/back")
    await master.call(StartNode(node))
    async with asyncio.timeout(LIMIT):
        while back.received.empty():
            there.publish(serialize_message(String(data="ready")))
            await asyncio.sleep(0.1)
    killed = pid_of(f"__ns:=/{place}")
    dead_ports = ports_of(killed)
    os.kill(killed, signal.SIGKILL)
    assert (await master.died()).node == "killed"
    async with asyncio.timeout(15):  # less than the lease
        while await has_subscription(master, f"/{place}/there"):  # noqa: ASYNC110  # of another process
            await asyncio.sleep(0.05)
    numbers = [str(number) for number in range(20)]
    for number in numbers:
        there.publish(serialize_message(String(data=number)))
    await master.call(StartNode(node))
    received: list[str] = []
    while received[-1:] != numbers[-1:]:
        received.append(deserialize_message(await back.next(), String).data)
    assert received[-10:] == numbers[-10:]
    assert dead_ports
    assert not dead_ports & ports_of(pid_of(f"__ns:=/{place}"))  # through them it would hear nothing for seconds
    await master.call(StopNode("killed"))


async def has_subscription(master: FakeMaster, topic: str) -> bool:
    return any(each.name == topic and each.subscribers for each in (await master.call(ReadGraph())).topics)


def ports_of(pid: int) -> set[str]:
    """Return the ports in shared memory through which a process receives: it has locked their files."""
    locks = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
    locked = {int(lock[5].rpartition(":")[2]) for lock in locks if lock[1] == "FLOCK" and lock[4] == str(pid)}
    return {path.name for path in Path("/dev/shm").glob("fastdds_port*_el") if path.stat().st_ino in locked}


def pid_of(word: str) -> int:
    """Return the process that has a word in its command line."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if word.encode() in path.read_bytes():
                return int(path.parent.name)
    raise AssertionError(f"no process has {word}")


def test_farewell_has_the_form_of_the_standard() -> None:
    prefix = bytes(range(12))
    data = farewell(prefix)
    assert data[:4] == b"RTPS"
    assert data[8:20] == prefix
    assert int.from_bytes(data[22:24], "little") == len(data) - 24
    assert data.count(prefix) == 2
    assert data.endswith(bytes((0x71, 0, 4, 0, 0, 0, 0, 3, 1, 0, 0, 0)))

"""Killed participants, with real processes of ROS 2."""

from __future__ import annotations

import asyncio
import os
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
from rce.protocol.messages import Qos
from tests.support.endpoints.environment_driver import FakeMaster

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

def until(condition):
    deadline = time.monotonic() + 10  # half of the lease
    while not condition():
        assert time.monotonic() < deadline, "not within 10 s"
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
until(lambda: not infos("/farewell"))
until(lambda: tell() == 0)  # its other endpoints go one after the other
"""


def test_killed_participant_is_removed_at_once() -> None:
    """Without the message it stays for the 20 s of its lease.

    The processes have a network of their own: Fast DDS derives the id of the host from its addresses, and other tests
    add and remove networks meanwhile.
    """
    separate = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]
    network = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
    environ = os.environ | {"ROS_DOMAIN_ID": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    command = [*separate, *network, sys.executable, "-c", OBSERVER, TALKER]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


async def test_messages_after_the_death_of_a_node_wait_for_its_successor(master: FakeMaster) -> None:
    node = NodeSpec("killed", "probe", "echo.py", namespace="killed")
    there = await master.interface("PublisherInterface", "std_msgs/String", "/killed/there", Qos(durability="volatile"))
    back = await master.interface("SubscriberInterface", "std_msgs/String", "/killed/back")
    await master.call(StartNode(node))
    async with asyncio.timeout(30):
        while back.received.empty():
            there.publish(serialize_message(String(data="ready")))
            await asyncio.sleep(0.1)
    os.kill(pid_of("__ns:=/killed"), signal.SIGKILL)
    assert (await master.died()).node == "killed"
    numbers = [str(number) for number in range(20)]
    for number in numbers:
        there.publish(serialize_message(String(data=number)))
        await asyncio.sleep(0.05)  # the first ones may be lost, until DDS has removed the node
    await master.call(StartNode(node))
    received: list[str] = []
    while received[-1:] != numbers[-1:]:
        received.append(deserialize_message(await back.next(30), String).data)
    assert received[-10:] == numbers[-10:]
    await master.call(StopNode("killed"))


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

"""A container's networks held to a bandwidth from outside, in a network name space as a container has one."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator

import pytest

from containers import shaping
from rce.errors import InvalidRequest, StartFailed

RATE = 1_000_000


@pytest.fixture
def process() -> Iterator[int]:
    """A process with a network of its own: eth0, whose other end reads nothing."""
    if os.geteuid() != 0:
        pytest.skip("network name spaces need root: run the tests as root")
    try:
        shaping.check()
    except InvalidRequest as error:
        pytest.skip(str(error))
    with subprocess.Popen(["unshare", "--net", "sleep", "60"]) as running:
        try:
            while os.readlink(f"/proc/{running.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
                time.sleep(0.01)
            inside(running.pid, "ip", "link", "add", "eth0", "type", "veth", "peer", "name", "other")
            for words in (["addr", "add", "10.9.9.1/24", "dev", "eth0"], ["link", "set", "eth0", "up"]):
                inside(running.pid, "ip", *words)
            inside(running.pid, "ip", "link", "set", "other", "up")
            yield running.pid
        finally:
            running.kill()


def inside(process: int, *words: str) -> str:
    command = ["nsenter", f"--net=/proc/{process}/ns/net", *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


SEND = """
import socket, time
line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
line.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 20_000)
until = time.monotonic() + 0.5
while time.monotonic() < until:
    line.sendto(bytes(1000), ("10.9.9.255", 9))
"""


def sent(process: int) -> int:
    """Bytes that have left eth0."""
    return int(inside(process, "cat", "/proc/net/dev").split("eth0:")[1].split()[8])


def test_what_is_sent_is_held_to_the_rate(process: int) -> None:
    shaping.shape(process, ["eth0"], RATE)
    shaping.shape(process, ["eth0"], RATE)  # after a restart of the task set
    began, before = time.monotonic(), sent(process)
    inside(process, "python3", "-c", SEND)
    took = time.monotonic() - began
    assert 0.2 * RATE < sent(process) - before < RATE * (took + 0.1)


def test_the_large_packets_of_a_group_get_through(process: int) -> None:
    for device in ("eth0", "other"):
        inside(process, "ip", "link", "set", device, "mtu", "65000")
    shaping.shape(process, ["eth0"], 100_000)
    before = sent(process)
    large = SEND.replace("20_000", "200_000").replace("1000", "64_000")
    inside(process, "python3", "-c", large)
    assert sent(process) - before > 64_000


def test_a_network_that_is_not_there(process: int) -> None:
    with pytest.raises(StartFailed, match="eth1"):
        shaping.shape(process, ["eth0", "eth1"], RATE)


def test_a_process_that_has_ended_is_somebody_elses_matter() -> None:
    shaping.shape(2**22 + 1, ["eth0"], RATE)


def test_without_root_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(InvalidRequest) as raised:
        shaping.check()
    assert raised.value.field == "containerData.bandwidth"

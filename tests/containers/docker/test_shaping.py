"""Bandwidth limits set from outside, in a network namespace like that of a container."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator

import pytest

from containers.docker import shaping
from rce.errors import InvalidRequest, StartFailed

RATE = 1_000_000


@pytest.fixture
def process() -> Iterator[int]:
    """A process with a network of its own: eth0, to whose other end nothing listens."""
    if os.geteuid() != 0:
        pytest.skip("network namespaces need root: run the tests as root")
    try:
        shaping.check()
    except InvalidRequest as error:
        pytest.skip(str(error))
    with subprocess.Popen(["unshare", "--net", "sleep", "1000"]) as running:
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
import socket
line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
line.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
line.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 20_000)
for _ in range(500):
    line.sendto(bytes(1000), ("10.9.9.255", 9))
"""


def sent(process: int) -> int:
    """Return the number of bytes sent on eth0."""
    return int(inside(process, "cat", "/proc/net/dev").split("eth0:")[1].split()[8])


def test_sending_is_limited_to_the_rate(process: int) -> None:
    shaping.shape(process, ["eth0"], RATE)
    shaping.shape(process, ["eth0"], RATE)  # again, as after a restart of the task set
    began, before = time.monotonic(), sent(process)
    inside(process, "python3", "-c", SEND)
    took = time.monotonic() - began
    assert 0.2 * RATE < sent(process) - before < RATE * (took + 0.1)


def test_large_packets_of_a_group_network_pass(process: int) -> None:
    for device in ("eth0", "other"):
        inside(process, "ip", "link", "set", device, "mtu", "65000")
    shaping.shape(process, ["eth0"], 100_000)
    before = sent(process)
    large = SEND.replace("20_000", "200_000").replace("1000", "64_000").replace("500", "3")
    inside(process, "python3", "-c", large)
    assert sent(process) - before > 64_000


def test_missing_network_device_is_reported(process: int) -> None:
    with pytest.raises(StartFailed, match="eth1"):
        shaping.shape(process, ["eth0", "eth1"], RATE)


def test_ended_process_is_not_an_error() -> None:
    shaping.shape(2**22 + 1, ["eth0"], RATE)


def test_bandwidth_limit_is_refused_without_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(InvalidRequest) as raised:
        shaping.check()
    assert raised.value.field == "containerData.bandwidth"

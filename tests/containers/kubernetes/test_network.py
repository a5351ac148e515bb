"""Confinement of a network namespace from outside, with a real one where that is possible."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from containers.docker.shaping import devices
from containers.kubernetes import network
from containers.kubernetes.network import GROUP_DEVICE, confine, connect, rules
from rce.control.calls.environments import Group
from rce.errors import StartFailed

GROUP = Group("ann/pair", "10.128.0.0/24", "10.128.0.2", {"map": "10.128.0.2"})
needs_namespaces = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("unshare") is None, reason="network namespaces need root: run the tests as root"
)


@contextmanager
def pod(address: str = "10.9.0.2") -> Iterator[int]:
    """Process in a network namespace with one interface, as the first process of a pod."""
    process = subprocess.Popen(["unshare", "--net", "sleep", "60"])
    try:
        until = time.monotonic() + 10
        while os.readlink(f"/proc/{process.pid}/ns/net") == os.readlink("/proc/self/ns/net"):
            assert time.monotonic() < until
            time.sleep(0.01)
        for words in (
            "link add eth0 type veth peer name peer0",
            f"address add {address}/24 dev eth0",
            "link set eth0 up",
        ):
            inside(process.pid, "ip", *words.split())
        inside(process.pid, "ip", "link", "set", "lo", "up")
        yield process.pid
    finally:
        process.kill()
        process.wait()


def inside(process: int, *words: str) -> str:
    command = ["nsenter", f"--net=/proc/{process}/ns/net", *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_closed_filter_lets_nothing_out_but_the_tunnel_to_peers() -> None:
    lines = rules("none", ["10.1.0.5"], group=True).splitlines()
    assert ":OUTPUT DROP" in lines
    assert "-A OUTPUT -d 10.1.0.5/32 -p udp -m udp --dport 4789 -j ACCEPT" in lines
    assert lines[-2:] == ["-A OUTPUT -j REJECT", "COMMIT"]
    assert not any("conntrack" in line for line in lines)


def test_internet_excludes_private_networks_before_all_else_is_accepted() -> None:
    lines = rules("internet", [], group=False).splitlines()
    refused = [line for line in lines if line.endswith("-j REJECT")]
    assert "-A OUTPUT -d 169.254.0.0/16 -j REJECT" in refused
    assert lines.index(refused[-1]) < lines.index("-A OUTPUT -j ACCEPT")
    assert not any(line.startswith("-A INPUT") and "-i lo" not in line and "ESTABLISHED" not in line for line in lines)


def test_of_a_list_nothing_but_its_addresses_is_reached() -> None:
    lines = rules("10.0.0.5:5432,192.0.2.0/28:443", [], group=False).splitlines()
    accepted = [line for line in lines if line.startswith("-A OUTPUT") and "-o lo" not in line]
    assert accepted == [
        "-A OUTPUT -d 10.0.0.5 -p tcp -m tcp --dport 5432 -j ACCEPT",
        "-A OUTPUT -d 192.0.2.0/28 -p tcp -m tcp --dport 443 -j ACCEPT",
        "-A OUTPUT -j REJECT",
    ]


def test_everything_is_reached_with_egress_all() -> None:
    assert "REJECT" not in rules("all", [], group=False)


@needs_namespaces
def test_interfaces_are_down_without_egress() -> None:
    with pod() as process:
        confine(process, "none", None)
        assert "state DOWN" in inside(process, "ip", "link", "show", "eth0")
        assert inside(process, "ip", "route") == ""


@needs_namespaces
def test_egress_leaves_the_interface_up_behind_a_filter() -> None:
    with pod() as process:
        confine(process, "internet", None)
        shown = inside(process, "iptables", "-S")
        assert "-P INPUT DROP" in shown
        assert "-d 169.254.0.0/16" in shown
        assert "state DOWN" not in inside(process, "ip", "link", "show", "eth0")
        assert inside(process, "sh", "-c", "cat /proc/sys/net/ipv6/conf/eth0/disable_ipv6").strip() == "1"


@needs_namespaces
def test_group_is_a_tunnel_to_its_peers() -> None:
    with pod() as process:
        confine(process, "none", GROUP)
        assert GROUP_DEVICE in devices(process)
        assert "10.128.0.2/24" in inside(process, "ip", "address", "show", GROUP_DEVICE)
        connect(process, "none", GROUP, ["10.9.0.3", "10.9.0.4"])
        connect(process, "none", GROUP, ["10.9.0.4", "10.9.0.5"])
        flooded = inside(process, "bridge", "fdb", "show", "dev", GROUP_DEVICE)
        assert [address in flooded for address in ("10.9.0.3", "10.9.0.4", "10.9.0.5")] == [False, True, True]
        shown = inside(process, "iptables", "-S")
        assert "10.9.0.3" not in shown
        assert "-d 10.9.0.5/32" in shown
        confine(process, "none", GROUP)  # by the next agent


@needs_namespaces
def test_failure_is_an_error_with_the_reason() -> None:
    with pod() as process, pytest.raises(StartFailed, match="cannot be set up: ip: "):
        network._inside(process, "ip", "link", "set", "dev", "missing", "down")

"""Simulated machines, whose links can be cut."""

from __future__ import annotations

import subprocess

import pytest

from rce.bench.network.bridge import Network
from tests.support.e2e.namespaces import network


def reaches(net: Network, name: str, address: str) -> bool:
    """Return whether a machine gets an answer from another: a refusal by its kernel is one."""
    program = f"import socket; print(socket.socket().connect_ex(({address!r}, 1)))"
    command = [*net.command_prefix(name), "timeout", "2", "python3", "-c", program]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip() == "111"


@pytest.mark.slow
def test_machines_reach_each_other_unless_a_link_is_cut() -> None:
    with network("alpha-1", "alpha-2") as net:
        assert reaches(net, "alpha-1", net.addresses["alpha-2"])
        assert reaches(net, "alpha-1", net.host)
        net.cut("alpha-2")
        assert not reaches(net, "alpha-1", net.addresses["alpha-2"])
        net.reconnect("alpha-2")
        assert reaches(net, "alpha-1", net.addresses["alpha-2"])
        assert net.pids("alpha-1") == []

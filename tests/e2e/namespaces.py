"""Machines on one: network namespaces of this process's own, joined by a bridge, whose links can be cut.

The host is on the bridge too. Needs root; nothing that others made is touched.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import pytest

TOOL = "ip"


class Network:
    """`10.B.C.1` is the host, the machines follow; B and C come from our pid."""

    def __init__(self, names: Sequence[str]) -> None:
        pid = os.getpid()
        self._net = f"10.{100 + pid // 250 % 100}.{pid % 250}"
        self._bridge = f"rce{pid}"
        self._names = list(names)
        self.host = f"{self._net}.1"
        self.addresses = {name: f"{self._net}.{number}" for number, name in enumerate(names, 2)}

    def make(self) -> None:
        _ip("link", "add", self._bridge, "type", "bridge")
        _ip("addr", "add", f"{self.host}/24", "dev", self._bridge)
        _ip("link", "set", self._bridge, "up")
        for name in self._names:
            space, port = self.space(name), self._port(name)
            _ip("netns", "add", space)
            _ip("link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", space)
            _ip("link", "set", port, "master", self._bridge, "up")
            _ip("-n", space, "addr", "add", f"{self.addresses[name]}/24", "dev", "eth0")
            for device in ("eth0", "lo"):
                _ip("-n", space, "link", "set", device, "up")
        self._let_through("-I")

    def remove(self) -> None:
        """Whatever there is of it."""
        self._let_through("-D")
        for name in self._names:
            self.kill(name)
            _ip("netns", "del", self.space(name), check=False)
            _ip("link", "del", self._port(name), check=False)
        _ip("link", "del", self._bridge, check=False)

    def entered_by(self, name: str) -> tuple[str, ...]:
        """What to put before a command that shall run on this machine."""
        return (TOOL, "netns", "exec", self.space(name))

    def cut(self, name: str) -> None:
        """Pull the machine's plug to the network."""
        _ip("link", "set", self._port(name), "down")

    def mend(self, name: str) -> None:
        _ip("link", "set", self._port(name), "up")

    def pids(self, name: str) -> list[int]:
        """The processes on this machine."""
        return [int(pid) for pid in _ip("netns", "pids", self.space(name), check=False).split()]

    def kill(self, name: str) -> None:
        """SIGKILL all that runs on this machine."""
        for pid in self.pids(name):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def space(self, name: str) -> str:
        """The name of its network namespace."""
        return f"{self._bridge}-{name}"

    def _port(self, name: str) -> str:
        return f"{self._bridge}{name[:4]}"

    def _let_through(self, action: str) -> None:
        """Where a Docker on this host has iptables look at bridged frames, it drops those that it does not know."""
        if shutil.which("iptables"):
            rule = ["FORWARD", "-i", self._bridge, "-o", self._bridge, "-j", "ACCEPT"]
            subprocess.run(["iptables", "-w", action, *rule], check=False, capture_output=True)


@contextmanager
def network(*names: str) -> Iterator[Network]:
    """A network with these machines, while the context lasts; skips the test where there can be none."""
    if os.geteuid() != 0 or shutil.which(TOOL) is None:
        pytest.skip("network namespaces need root and iproute2: run the tests as root to have this one")
    made = Network(names)
    try:
        try:
            made.make()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no network namespaces here: {error.stderr.strip()}")
        yield made
    finally:
        made.remove()


def _ip(*words: str, check: bool = True) -> str:
    return subprocess.run([TOOL, *words], check=check, capture_output=True, text=True).stdout

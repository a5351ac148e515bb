"""Simulated machines: network namespaces, joined by a bridge, whose links can be cut. Needs root.

The host is on the bridge too. Names contain the pid, so that concurrent networks do not collide.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress

from rce.bench.network.namespaces import IP, ip
from rce.errors import Unavailable


class Network:
    """Network of the host, `10.B.C.1`, and the machines, which follow. B and C depend on the pid."""

    def __init__(self, names: Sequence[str]) -> None:
        pid = os.getpid()
        self._net = f"10.{100 + pid // 250 % 100}.{pid % 250}"
        self._bridge = f"rce{pid}"
        self._names = list(names)
        self.host = f"{self._net}.1"
        self.addresses = {name: f"{self._net}.{number}" for number, name in enumerate(names, 2)}

    def make(self) -> None:
        """Make bridge and namespaces."""
        ip("link", "add", self._bridge, "type", "bridge")
        ip("addr", "add", f"{self.host}/24", "dev", self._bridge)
        ip("link", "set", self._bridge, "up")
        for name in self._names:
            space, port = self.space(name), self._port(name)
            ip("netns", "add", space)
            ip("link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", space)
            ip("link", "set", port, "master", self._bridge, "up")
            ip("-n", space, "addr", "add", f"{self.addresses[name]}/24", "dev", "eth0")
            for device in ("eth0", "lo"):
                ip("-n", space, "link", "set", device, "up")
        self._set_forwarding("-I")

    def remove(self) -> None:
        """Remove everything that exists of it."""
        self._set_forwarding("-D")
        for name in self._names:
            self.kill(name)
            for words in (("netns", "del", self.space(name)), ("link", "del", self._port(name))):
                with suppress(Unavailable):
                    ip(*words)
        with suppress(Unavailable):
            ip("link", "del", self._bridge)

    def command_prefix(self, name: str) -> tuple[str, ...]:
        """Return the words before a command that run it on a machine."""
        return (IP, "netns", "exec", self.space(name))

    def cut(self, name: str) -> None:
        """Disconnect a machine from the network."""
        ip("link", "set", self._port(name), "down")

    def reconnect(self, name: str) -> None:
        """Connect a machine to the network again."""
        ip("link", "set", self._port(name), "up")

    def pids(self, name: str) -> list[int]:
        """Return the processes on a machine."""
        with suppress(Unavailable):
            return [int(pid) for pid in ip("netns", "pids", self.space(name)).split()]
        return []

    def kill(self, name: str) -> None:
        """Kill all processes on a machine."""
        for pid in self.pids(name):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def space(self, name: str) -> str:
        """Return the name of a machine's network namespace."""
        return f"{self._bridge}-{name}"

    def _port(self, name: str) -> str:
        return f"{self._bridge}p{self._names.index(name)}"

    def _set_forwarding(self, action: str) -> None:
        """Add or remove the rule that lets frames pass on the bridge, which Docker's rules otherwise drop."""
        if shutil.which("iptables"):
            rule = ["FORWARD", "-i", self._bridge, "-o", self._bridge, "-j", "ACCEPT"]
            subprocess.run(["iptables", "-w", action, *rule], check=False, capture_output=True)

"""What makes Services work in a cluster of the tests: kube-proxy on each node, and the cluster's DNS.

The DNS server is Twisted's, which reads the addresses of the Services from a file.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.support.kubernetes.build import directory
from tests.support.kubernetes.cluster import DOMAIN, SERVICES, Cluster
from tests.support.swarm_nodes import run

# These settings of the kernel are read-only in a container, in which the tests may run.
AS_THEY_ARE = (
    "--conntrack-max-per-core=0",
    "--conntrack-tcp-timeout-established=0",
    "--conntrack-tcp-timeout-close-wait=0",
)


class Services:
    """Programs that make the Services of a cluster reachable, by address and by name, until `close`."""

    def __init__(self, cluster: Cluster, place: Path) -> None:
        self._cluster = cluster
        self._hosts = place / "hosts"
        self._hosts.touch()
        dns = [sys.executable, "-m", "twisted", "dns", f"--interface={cluster.address}", "--port=53"]
        self._programs = [self._spawn(place / "dns.log", [*dns, f"--hosts-file={self._hosts}"])]
        for node in cluster.nodes:
            proxy = [str(directory() / "kube-proxy"), f"--kubeconfig={cluster.kubeconfig}", "--proxy-mode=iptables"]
            proxy += [f"--hostname-override={node.name}", "--healthz-bind-address=", "--metrics-bind-address=127.0.0.1"]
            # A node chooses a route before kube-proxy's rules change the address.
            run("ip", "-n", node.name, "route", "add", SERVICES, "via", cluster.address)
            words = ["nsenter", f"--net=/run/netns/{node.name}", *proxy, *AS_THEY_ARE]
            self._programs.append(self._spawn(place / f"{node.name}-proxy.log", words))

    def publish(self, namespace: str) -> None:
        """Enter the Services of a namespace into the DNS."""
        services = json.loads(self._cluster.kubectl("get", "services", f"--namespace={namespace}", "--output=json"))
        lines = [
            f"{each['spec']['clusterIP']} {each['metadata']['name']}.{namespace}.svc.{DOMAIN}\n"
            for each in services["items"]
        ]
        self._hosts.write_text("".join(lines))

    def close(self) -> None:
        """End the programs."""
        for program in self._programs:
            program.terminate()
        for program in self._programs:
            program.wait(10)

    def _spawn(self, log: Path, words: list[str]) -> subprocess.Popen[bytes]:
        with log.open("wb") as output:
            return subprocess.Popen(words, stdout=output, stderr=output, start_new_session=True)

"""A Kubernetes cluster for the tests: its servers on this machine, and nodes that are network namespaces.

Each node has a dockerd and a kubelet of its own, as the machines of a swarm have (swarm_nodes.py). Pods are on the
bridge of their node's Docker, and nodes have routes to each other's pods. No network plugin enforces NetworkPolicy.
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from rce.net.certificates import Authority
from tests.support.certificates import certify
from tests.support.kubernetes.build import directory, lacking
from tests.support.swarm_nodes import Node, Swarm, run

START_TIMEOUT = 120.0  # seconds
STOP_TIMEOUT = 60.0
NAMESPACE = "rce-tests"
PAUSE = "rce-test/pause:1"  # keeps the namespaces of a pod
SERVICES, FIRST_SERVICE = "10.232.0.0/24", "10.232.0.1"
DOMAIN = "cluster.local"
TOKEN = "secret"
# Inside another container runc can neither lower a process's score for the kernel's out-of-memory killer, nor give a
# privileged container capabilities that this machine does not have.
CLAMP = """#!/usr/bin/python3
import json, os, sys
NAMES = "{names}".split()
words = sys.argv[1:]
bounds = next(line.split()[1] for line in open("/proc/self/status") if line.startswith("CapBnd"))
here = {{name for bit, name in enumerate(NAMES) if int(bounds, 16) >> bit & 1}}
if "create" in words or "run" in words:
    bundle = next((words[i + 1] for i, word in enumerate(words) if word in ("--bundle", "-b")), ".")
    path = os.path.join(bundle, "config.json")
    spec = json.load(open(path))
    process = spec["process"]
    process["oomScoreAdj"] = max(0, process.get("oomScoreAdj", 0))
    for kind, given in process.get("capabilities", {{}}).items():
        process["capabilities"][kind] = [name for name in given if name in here]
    json.dump(spec, open(path, "w"))
os.execvp("runc", ["runc", *words])
"""
CAPABILITIES = """
chown dac_override dac_read_search fowner fsetid kill setgid setuid setpcap linux_immutable net_bind_service
net_broadcast net_admin net_raw ipc_lock ipc_owner sys_module sys_rawio sys_chroot sys_ptrace sys_pacct
sys_admin sys_boot sys_nice sys_resource sys_time sys_tty_config mknod lease audit_write audit_control setfcap
mac_override mac_admin syslog wake_alarm block_suspend audit_read perfmon bpf checkpoint_restore
"""  # by number, capabilities(7)
# Kubelet removes the logs of all pods that it does not know.
OWN_LOGS = 'mountpoint -q /var/log || mount -t tmpfs none /var/log; exec "$@"'
KUBELET = {
    "apiVersion": "kubelet.config.k8s.io/v1beta1",
    "kind": "KubeletConfiguration",
    "authentication": {"anonymous": {"enabled": True}, "webhook": {"enabled": False}},
    "authorization": {"mode": "AlwaysAllow"},
    "cgroupDriver": "cgroupfs",
    "cgroupsPerQOS": False,
    "enforceNodeAllocatable": [],
    "failSwapOn": False,
    "evictionHard": {"memory.available": "50Mi"},
    "imageGCHighThresholdPercent": 100,
    "readOnlyPort": 0,
    "healthzPort": 0,
    "nodeStatusUpdateFrequency": "2s",
    "nodeStatusReportFrequency": "2s",
    "syncFrequency": "5s",
}


class Cluster:
    """Servers and nodes; this machine reaches all of them, and they reach it at `address`."""

    def __init__(self, place: Path) -> None:
        self.machines = Swarm(place)
        self.kubelets: dict[str, subprocess.Popen[bytes]] = {}  # by node
        self.kubeconfig = place / "kubeconfig"
        self._place = place
        self._servers: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        return self.machines.address

    @property
    def nodes(self) -> list[Node]:
        return self.machines.nodes

    @property
    def common(self) -> Path:
        """Directory that is another one on each node."""
        return self._place / "docker"

    def open(self, count: int) -> None:
        """Start the servers and the machines of the nodes, in which no kubelet runs yet."""
        clamp = self._place / "clamp"
        clamp.write_text(CLAMP.format(names=" ".join(f"CAP_{name.upper()}" for name in CAPABILITIES.split())))
        clamp.chmod(0o755)
        self.machines.open()
        for number in range(1, count + 1):
            self.machines.add(
                f"--bip={self.machines.net}.{100 + number}.1/24",
                f"--add-runtime=clamp={clamp}",
                "--default-runtime=clamp",
                "--ip-masq=false",  # pods see the addresses of each other, as Kubernetes demands
            )
        self._start_servers()
        self.machines.wait()
        for number, node in enumerate(self.nodes, 1):
            pods = f"{self.machines.net}.{100 + number}.0/24"
            run("ip", "route", "add", pods, "via", node.address)  # of the answers of the servers here
            for other in self.nodes:
                if other is not node:
                    run("ip", "-n", other.name, "route", "add", pods, "via", node.address)
        for node in self.nodes:
            # Docker drops what is forwarded to its bridge from outside.
            run("nsenter", f"--net=/run/netns/{node.name}", "iptables", "-w", "-P", "FORWARD", "ACCEPT")
            run("nsenter", f"--net=/run/netns/{node.name}", "iptables", "-w", "-I", "FORWARD", "-j", "ACCEPT")

    def start_kubelet(self, node: Node) -> None:
        """Start the kubelet of a node, in its namespaces."""
        config = node.directory / "kubelet.json"
        config.write_text(json.dumps({**KUBELET, "clusterDomain": DOMAIN, "clusterDNS": [self.address]}))
        words = ["nsenter", f"--net=/run/netns/{node.name}", f"--mount=/proc/{self._docker(node)}/ns/mnt"]
        words += [
            "sh",
            "-c",
            OWN_LOGS,
            "sh",
            str(directory() / "kubelet"),
            f"--kubeconfig={self.kubeconfig}",
            f"--config={config}",
        ]
        words += [f"--docker-endpoint=unix://{self.common}/docker.sock", f"--root-dir={self.common}/kubelet"]
        words += [f"--seccomp-profile-root={self.common}/kubelet/seccomp", f"--hostname-override={node.name}"]
        words += [f"--pod-infra-container-image={PAUSE}", f"--node-ip={node.address}", "--v=2"]
        self.kubelets[node.name] = self._spawn(f"{node.name}-kubelet", words)

    def kill_kubelet(self, node: Node) -> None:
        """Kill the kubelet of a node; its containers keep running."""
        self.kubelets[node.name].kill()
        self.kubelets[node.name].wait(STOP_TIMEOUT)

    def wait(self) -> None:
        """Wait until all nodes are ready, and the namespace of the tests has its service account."""
        self._until(lambda: len(self._ready()) == len(self.nodes), "nodes are ready")
        self.kubectl("create", "namespace", NAMESPACE)
        self._until(lambda: self._found("serviceaccount", "default"), "the service account exists")

    def kubectl(self, *words: str, given: str = "", check: bool = True) -> str:
        """Run kubectl; return its output."""
        done = subprocess.run(
            ["kubectl", f"--kubeconfig={self.kubeconfig}", *words], input=given or None, capture_output=True, text=True
        )
        assert not check or done.returncode == 0, done.stderr
        return done.stdout

    def get(self, kind: str, *words: str, namespace: str = NAMESPACE) -> list[dict[str, Any]]:
        """Return objects of a kind."""
        found: list[dict[str, Any]] = json.loads(
            self.kubectl("get", kind, f"--namespace={namespace}", "--output=json", *words)
        )["items"]
        return found

    def log(self, name: str) -> str:
        """Return the last lines of a server's log."""
        return "\n".join((self._place / f"{name}.log").read_text().splitlines()[-20:])

    def close(self) -> None:
        """Stop everything and delete the bridge."""
        for process in [*self.kubelets.values(), *reversed(self._servers)]:
            if process.poll() is None:
                process.terminate()
        for process in [*self.kubelets.values(), *self._servers]:
            with suppress(subprocess.TimeoutExpired):
                process.wait(STOP_TIMEOUT)
            process.kill()
        for node in self.nodes:
            self._kill_containers(node)
        self.machines.close()

    def _kill_containers(self, node: Node) -> None:
        """Kill the containers that the kubelet has left, which would keep the directories of their volumes."""
        with suppress(OSError, subprocess.CalledProcessError):
            for container in node.api().containers(quiet=True):
                node.api().kill(container["Id"])

    def _start_servers(self) -> None:
        authority = Authority.make("tests of RCE")
        names = [self.address, FIRST_SERVICE, "kubernetes.default.svc", "kubernetes"]
        certificates = certify(self._place / "certificates", authority, names)
        key = self._place / "service-accounts.key"
        run("openssl", "genrsa", "-out", str(key), "2048")
        tokens = self._place / "tokens.csv"
        tokens.write_text(f'{TOKEN},admin,admin,"system:masters"\n')
        self._write_kubeconfig(certificates / "ca.pem")
        etcd, peers = f"http://{self.address}:2379", f"http://{self.address}:2380"
        words = ["etcd", f"--data-dir={self._place / 'etcd'}", f"--listen-client-urls={etcd}"]
        words += [f"--advertise-client-urls={etcd}", f"--listen-peer-urls={peers}"]
        words += [f"--initial-advertise-peer-urls={peers}", f"--initial-cluster=default={peers}"]
        self._servers.append(self._spawn("etcd", words))
        words = [f"--etcd-servers={etcd}", "--secure-port=6443", f"--bind-address={self.address}"]
        words += [f"--tls-cert-file={certificates / 'cert.pem'}", f"--tls-private-key-file={certificates / 'key.pem'}"]
        words += [f"--token-auth-file={tokens}", f"--service-cluster-ip-range={SERVICES}", "--authorization-mode=RBAC"]
        words += [f"--service-account-key-file={key}", f"--service-account-signing-key-file={key}"]
        words += ["--service-account-issuer=https://kubernetes.default.svc", "--allow-privileged=true"]
        words += ["--kubelet-preferred-address-types=InternalIP", f"--cert-dir={self._place / 'made'}"]
        self._server("kube-apiserver", words)
        self._until(lambda: "ok" in self.kubectl("get", "--raw", "/readyz", check=False), "the API server is ready")
        words = [f"--service-account-private-key-file={key}", f"--root-ca-file={certificates / 'ca.pem'}"]
        words += ["--leader-elect=false", "--port=0", "--secure-port=0", "--node-monitor-period=1s"]
        words += ["--node-monitor-grace-period=10s", f"--kubeconfig={self.kubeconfig}"]
        self._server("kube-controller-manager", words)
        words = [f"--kubeconfig={self.kubeconfig}", "--leader-elect=false", "--port=0", "--secure-port=0"]
        self._server("kube-scheduler", words)

    def _server(self, name: str, words: list[str]) -> None:
        self._servers.append(self._spawn(name, [str(directory() / name), *words]))

    def _spawn(self, name: str, words: list[str]) -> subprocess.Popen[bytes]:
        with (self._place / f"{name}.log").open("ab") as log:
            return subprocess.Popen(words, stdout=log, stderr=log, start_new_session=True)

    def _write_kubeconfig(self, authority: Path) -> None:
        server = {"server": f"https://{self.address}:6443", "certificate-authority": str(authority)}
        config = {
            "apiVersion": "v1",
            "kind": "Config",
            "clusters": [{"name": "tests", "cluster": server}],
            "users": [{"name": "admin", "user": {"token": TOKEN}}],
            "contexts": [{"name": "tests", "context": {"cluster": "tests", "user": "admin"}}],
            "current-context": "tests",
        }
        self.kubeconfig.write_text(yaml.safe_dump(config))

    def _docker(self, node: Node) -> int:
        return int((node.directory / "pid").read_text())

    def _ready(self) -> list[str]:
        found = json.loads(self.kubectl("get", "nodes", "--output=json", check=False) or '{"items": []}')["items"]
        conditions = {each["metadata"]["name"]: each["status"].get("conditions", []) for each in found}
        return [
            name
            for name, each in conditions.items()
            if any(one["type"] == "Ready" and one["status"] == "True" for one in each)
        ]

    def _found(self, kind: str, name: str) -> bool:
        return bool(self.kubectl("get", kind, name, f"--namespace={NAMESPACE}", "--ignore-not-found"))

    def _until(self, condition: Any, what: str) -> None:
        until = time.monotonic() + START_TIMEOUT
        while not condition():
            dead = [each.args for each in self._servers if each.poll() is not None]
            logs = "\n".join(self.log(path.stem) for path in self._place.glob("*.log"))
            assert not dead, f"{dead} has ended:\n{logs}"
            assert time.monotonic() < until, f"not so within {START_TIMEOUT:g} s: {what}\n{logs}"
            time.sleep(0.2)


@contextmanager
def cluster_of(count: int, prepare: Any) -> Iterator[Cluster]:
    """Make a cluster of `count` nodes, or skip the test where that is not possible.

    `prepare` loads images into the Docker of a node before its kubelet starts.
    """
    if reason := lacking():
        pytest.skip(reason)
    with tempfile.TemporaryDirectory(prefix="rce-k8s-", ignore_cleanup_errors=True) as place:
        made = Cluster(Path(place))
        before = os.environ.get("KUBECONFIG")
        os.environ["KUBECONFIG"] = str(made.kubeconfig)
        try:
            made.open(count)
            for node in made.nodes:
                prepare(node)
                made.start_kubelet(node)
            made.wait()
            yield made
        finally:
            os.environ.pop("KUBECONFIG")
            if before is not None:
                os.environ["KUBECONFIG"] = before
            made.close()

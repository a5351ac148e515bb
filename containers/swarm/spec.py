"""Specifications of the services of environments and agents, in the form of Docker's API."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from containers.docker import disks, seccomp
from containers.docker.api import DOCKER_SOCKET
from containers.docker.networks import EGRESS, NO_NAMESERVER
from containers.endpoint import (
    CONTROL,
    HOME,
    HOME_SIZE,
    INODES,
    LOG_SIZE,
    OPEN_FILES,
    TEMPORARY_SIZE,
    EndpointPaths,
    environment_user,
    variables,
)
from containers.limits import Limits
from containers.packages import package_directories, package_path
from containers.settings import EGRESS_POOL, NAMESERVERS
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import InvalidRequest
from rce.net.tls import Tls
from rce.protocol.messages import ContainerData
from rce.protocol.slots import MB

Spec = dict[str, Any]
AGENT = "rce.agent"  # label of the agents' service and tasks
SPEC = "rce.spec"  # label of an environment's container, with what the agent must know of it
PACKAGES = "/run/rce-packages"  # path of the users' packages in a container
LONGEST_HOSTNAME = 63
SOCKETS = "/run/rce-user"  # path in a container of the sockets of its user's environments on the node
STOP_TIMEOUT = 12  # seconds; the endpoint stops its nodes in less time
SOCKETS_SIZE, SOCKETS_INODES = 64 * 1024, 1000
FEATURE = "node.labels.rce.feature."  # prefix of node labels, which have the value `true` for each special feature
GPU = "NVIDIA-GPU"  # name of the generic resource, as in Docker's manual
NODE = "{{.Node.ID}}"  # Swarm replaces this by the id of the task's node
NANO = 1_000_000_000
AGENT_MEMORY, AGENT_PROCESSES = 1024 * MB, 512


class AgentService(Struct, frozen=True):
    """Settings of the agents.

    Agents reach the task set at `address` (empty: that of the manager's node) and accept data links from other machines
    on `data_port` (0: any free port). `entry` is as in `Fetcher`; `egress_pool` and `nameservers` are as in `Networks`.
    """

    image: str
    address: str = ""
    data_port: int = 0
    entry: str = ""
    egress_pool: str = EGRESS_POOL
    nameservers: Sequence[str] = NAMESERVERS
    mounts: Sequence[str] = ()
    command: Sequence[str] = ("python3", "-P", "-m", "containers.swarm.agent")


class Names(Struct, frozen=True):
    """Names of an environment's volumes, which are unique on a swarm with several task sets.

    `owner` stands for one user of one task set.
    """

    run: str
    owner: str

    @staticmethod
    def of(labels: Mapping[str, str], name: str, run: str) -> Names:
        """Return the names for a run of the environment `name` of the task set with these labels."""
        owner = f"{sorted(labels.items())} {name.partition('/')[0]}"
        return Names(run, hashlib.sha256(owner.encode()).hexdigest()[:16])

    @property
    def control(self) -> str:
        """Volume with the sockets that the agent serves; read-only for the environment."""
        return f"rce-{self.run}-control"

    @property
    def home(self) -> str:
        """Volume in memory with the home directory."""
        return f"rce-{self.run}-home"

    @property
    def packages(self) -> str:
        """Volume with the users' packages that the agent has fetched."""
        return f"rce-{self.run}-packages"

    @property
    def disk(self) -> str:
        """Volume with the file of the environment's disk; the environment does not see it."""
        return f"rce-{self.run}-disk"

    @property
    def sockets(self) -> str:
        """Volume in memory that is shared by the user's environments on one node."""
        return f"rce-{self.owner}-links"

    @property
    def paths(self) -> EndpointPaths:
        """Paths as the environment sees them."""
        return EndpointPaths(Path(CONTROL), Path(SOCKETS) / f"{self.run}.sock")  # `SwarmEngine.sockets`


def check(spec: EnvironmentSpec) -> None:
    """Check options that no node can grant.

    Raises:
        InvalidRequest: The disk is too small, or Swarm uses the group address itself.
    """
    if spec.options.disk:
        disks.check_size(spec.options.disk)
    if spec.group is not None and IPv4Address(spec.group.address) in swarm_range(spec.group.subnet):
        raise InvalidRequest(
            f"environment {spec.name}: {spec.group.address} cannot be used, as Docker Swarm uses the upper half of a "
            "group's network itself: use an address of the lower half",
            field="containerData.groupIP",
        )


def swarm_range(subnet: str) -> IPv4Network:
    """Return the upper half of a group's network, from which Swarm assigns addresses that the agents then replace."""
    return list(IPv4Network(subnet).subnets(prefixlen_diff=1))[1]


def spec_label(spec: EnvironmentSpec) -> str:
    """Return the label with what an agent must know of an environment, without secrets and free text of users."""
    requested = spec.options
    options = ContainerData(disk=requested.disk, bandwidth=requested.bandwidth, io=requested.io)
    return msgspec.json.encode(replace(spec, token="", options=options)).decode()


def task_variables(spec: EnvironmentSpec, names: Names, settings: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables of the Environment endpoint, escaped for Swarm."""
    packages = package_path(package_directories(Path(PACKAGES), spec.packages), settings)
    values = variables(spec, names.paths, "", {**settings, **packages})
    return {key: _literal(value) for key, value in values.items()} | {"RCE_HOST": NODE}


def _literal(value: str) -> str:
    """Escape a value, which Swarm expands as a Go template."""
    return value.replace("{{", '{{"{{"}}')


def environment_task(
    spec: EnvironmentSpec,
    granted: Limits,
    names: Names,
    image: str,
    command: Sequence[str],
    variables: Mapping[str, str],
    labels: Mapping[str, str],
    constraints: Sequence[str],
    read_only: Sequence[str],
    network: str,
    nameservers: Sequence[str],
) -> Spec:
    """Return the task of one run of an environment.

    Swarm places it but never restarts it: a restarted environment is a new run with a new token, so it is a new
    service.
    """
    user = environment_user(spec.name)
    owner = f"uid={user},gid={user},mode=0700,nosuid,nodev"
    home = f"size={HOME_SIZE},nr_inodes={INODES},{owner}"
    sockets = f"size={SOCKETS_SIZE},nr_inodes={SOCKETS_INODES},noexec,nosuid,nodev,mode=0755"  # the agent writes
    requested = spec.options
    return {
        "ContainerSpec": {
            "Image": image,
            "Args": list(command),
            "Env": [f"{key}={value}" for key, value in variables.items()],
            "Labels": {**labels, SPEC: spec_label(spec), **({EGRESS: spec.egress} if spec.egress != "none" else {})},
            "Hostname": spec.name.partition("/")[2][:LONGEST_HOSTNAME] if spec.group is not None else "",
            "User": f"{user}:{user}",
            "ReadOnly": True,
            "CapabilityDrop": ["ALL"],
            "Privileges": {  # ignored by an older Docker; see `protected` of NodeReport
                "NoNewPrivileges": True,
                "Seccomp": {"Mode": "custom", "Profile": base64.b64encode(seccomp.profile().encode()).decode()},
            },
            "DNSConfig": {"Nameservers": [NO_NAMESERVER] if spec.egress == "none" else list(nameservers)},
            "Init": False,  # the image has an init process
            "StopGracePeriod": STOP_TIMEOUT * NANO,
            "Ulimits": [
                {"Name": "nofile", "Soft": OPEN_FILES, "Hard": OPEN_FILES},
                {"Name": "core", "Soft": 0, "Hard": 0},
            ],
            "Mounts": [
                _volume(names.control, CONTROL, labels, read_only=True),
                _volume(names.sockets, SOCKETS, _platform(labels), sockets, read_only=True),
                _volume(names.home, HOME, labels, home),
                *([_volume(names.packages, PACKAGES, labels, read_only=True)] if spec.packages else []),
                _memory("/tmp", TEMPORARY_SIZE),
                _memory("/dev/shm", granted.memory),
                *(_bind(path, read_only=True) for path in read_only),
            ],
        },
        "Resources": {
            "Limits": {"NanoCPUs": int(granted.cpu * NANO), "MemoryBytes": granted.memory, "Pids": granted.pids},
            # Swarm reserves only what is requested explicitly; slots are counted by the task set.
            "Reservations": {
                "NanoCPUs": int(requested.cpu * NANO),
                "MemoryBytes": int(requested.memory),
                "GenericResources": [{"DiscreteResourceSpec": {"Kind": GPU, "Value": requested.gpus}}][
                    : requested.gpus
                ],
            },
        },
        "RestartPolicy": {"Condition": "none"},
        "Placement": {"Constraints": list(constraints)},
        "Networks": [{"Target": network}],
        "LogDriver": {"Name": "json-file", "Options": {"max-size": LOG_SIZE, "max-file": "2"}},
    }


def agent_socket(host: str, nodes: int) -> str:
    """Return the path of Docker's socket on the nodes of a swarm.

    The only node of a swarm is the one of the manager, whose DOCKER_HOST is `host`. Others have the usual path: nobody
    knows another one.
    """
    return host.removeprefix("unix://") if nodes == 1 and host.startswith("unix://") else DOCKER_SOCKET


def agent_task(
    agent: AgentService,
    image: str,
    settings: Mapping[str, str],
    labels: Mapping[str, str],
    root: str,
    tls: Tls | None,
    socket: str = DOCKER_SOCKET,
) -> Spec:
    """Return the task of the agents, which run in the network of their node.

    Args:
        agent: Settings of the agents.
        image: The image, by its id or by a reference from which nodes pull it.
        settings: Further environment variables.
        labels: Labels of the containers.
        root: Docker's data directory, the same on all nodes.
        tls: Directory in which each node has its own certificate, the same on all nodes.
        socket: Docker's socket on the nodes.
    """
    variables = {
        **settings,
        "RCE_NODE": NODE,
        "RCE_DATA_PORT": str(agent.data_port),
        "RCE_ENTRY": agent.entry,
        "RCE_EGRESS_POOL": agent.egress_pool,
        "RCE_NAMESERVERS": ",".join(agent.nameservers),
    }
    mounts = list(agent.mounts)
    if tls is not None:
        variables["RCE_TLS"] = str(tls.directory)
        mounts.append(str(tls.directory))
    return {
        "ContainerSpec": {
            "Image": image,
            "Args": list(agent.command),
            "Env": [f"{key}={value}" for key, value in variables.items()],
            "Labels": dict(labels),
            "User": "0:0",
            "ReadOnly": True,
            "CapabilityAdd": ["CAP_NET_ADMIN", "CAP_NET_RAW"],  # for the packet filter of the node
            "Init": True,
            "StopGracePeriod": NANO,
            "Mounts": [
                {**_bind(socket), "Target": DOCKER_SOCKET},
                # Volumes in memory are mounted when an environment starts, so their mounts must propagate to the agent.
                {**_bind(f"{root}/volumes"), "BindOptions": {"Propagation": "rslave"}},
                _bind(f"{root}/containers"),  # with the hosts files of containers
                _memory("/tmp", TEMPORARY_SIZE),
                *(_bind(path, read_only=True) for path in mounts),
            ],
        },
        "Resources": {"Limits": {"MemoryBytes": AGENT_MEMORY, "Pids": AGENT_PROCESSES}},
        "RestartPolicy": {"Condition": "any", "Delay": NANO},
        "Networks": [{"Target": "host"}],
        "LogDriver": {"Name": "json-file", "Options": {"max-size": LOG_SIZE, "max-file": "2"}},
    }


def _platform(labels: Mapping[str, str]) -> dict[str, str]:
    """Return the labels that are common to all objects of the task set."""
    return {key: value for key, value in labels.items() if key in ("rce.platform", "rce.directory")}


def _volume(name: str, target: str, labels: Mapping[str, str], memory: str = "", read_only: bool = False) -> Spec:
    driver = {"Name": "local", "Options": {"type": "tmpfs", "device": "tmpfs", "o": memory}} if memory else None
    options = {"NoCopy": True, "Labels": dict(labels), "DriverConfig": driver}
    return {"Type": "volume", "Source": name, "Target": target, "ReadOnly": read_only, "VolumeOptions": options}


def _memory(target: str, size: int) -> Spec:
    return {"Type": "tmpfs", "Target": target, "TmpfsOptions": {"SizeBytes": size, "Mode": 0o1777}}


def _bind(path: str, read_only: bool = False) -> Spec:
    return {"Type": "bind", "Source": path, "Target": path, "ReadOnly": read_only}

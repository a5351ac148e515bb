"""What a swarm is told to run: the services of environments and of the agents, as Docker's API takes them."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path
from typing import Any

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from containers import docker_disks
from containers.docker_networks import EGRESS, NO_NAMESERVER
from containers.docker_options import (
    CONTROL,
    HOME,
    HOME_SIZE,
    INODES,
    LOG_SIZE,
    OPEN_FILES,
    TEMPORARY_SIZE,
    USER,
    Places,
    variables,
)
from containers.limits import Limits
from containers.packages import package_path, places
from containers.settings import EGRESS_POOL, NAMESERVERS
from rce.calls.environments import EnvironmentSpec
from rce.errors import InvalidRequest
from rce.messages import ContainerData
from rce.tls import Tls

Spec = dict[str, Any]
AGENT, SPEC = "rce.agent", "rce.spec"  # labels: of the agents' service and tasks; what an environment's agent must know
PACKAGES = "/run/rce-packages"  # where a container sees its users' packages
LONGEST_HOSTNAME = 63
SOCKETS = "/run/rce-user"  # where a container sees the sockets of its user's environments on its node
STOP_TIMEOUT = 12  # seconds; the endpoint stops its nodes in less
SOCKETS_SIZE, SOCKETS_INODES = 64 * 1024, 1000
FEATURE = "node.labels.rce.feature."  # a node that has a special feature has this label with the value `true`
GPU = "NVIDIA-GPU"  # the generic resource that Docker's own manual has for them
DOCKER_SOCKET = "/var/run/docker.sock"
NODE = "{{.Node.ID}}"  # Swarm puts the id of the node there where the task runs
NANO = 1_000_000_000


class AgentService(Struct, frozen=True):
    """How the agents are made. `address` is where they reach this task set; empty: that of the manager's node.
    `data_port` is where they take data links from other machines; 0: any that is free. `entry` is as `Fetcher` has it;
    networks that lead out are of `egress_pool` on each node, and ask `nameservers`."""

    image: str
    address: str = ""
    data_port: int = 0
    entry: str = ""
    egress_pool: str = EGRESS_POOL
    nameservers: Sequence[str] = NAMESERVERS
    mounts: Sequence[str] = ()
    command: Sequence[str] = ("python3", "-P", "-m", "containers.agent")


class Names(Struct, frozen=True):
    """What carries the name of an environment's life, and of its user, on a swarm that others may use too."""

    run: str
    owner: str
    """Tells the users of this task set from those of others."""

    @staticmethod
    def of(labels: Mapping[str, str], name: str, run: str) -> Names:
        whose = f"{sorted(labels.items())} {name.partition('/')[0]}"
        return Names(run, hashlib.sha256(whose.encode()).hexdigest()[:16])

    @property
    def control(self) -> str:
        """The volume with the sockets that its agent serves; the environment only reads it."""
        return f"rce-{self.run}-control"

    @property
    def home(self) -> str:
        """A volume in memory."""
        return f"rce-{self.run}-home"

    @property
    def packages(self) -> str:
        """The volume with the users' packages that its agent has fetched."""
        return f"rce-{self.run}-packages"

    @property
    def disk(self) -> str:
        """The volume with the file behind its disk, which it does not see itself."""
        return f"rce-{self.run}-disk"

    @property
    def sockets(self) -> str:
        """The volume, in memory, that the user's environments on one node share."""
        return f"rce-{self.owner}-sockets"

    @property
    def places(self) -> Places:
        """As the environment sees them."""
        return Places(Path(CONTROL), Path(SOCKETS) / f"{self.run}.sock")


def check(spec: EnvironmentSpec) -> None:
    """InvalidRequest for what cannot be had on any node."""
    if spec.options.disk:
        docker_disks.check_size(spec.options.disk)
    if spec.group is not None and IPv4Address(spec.group.address) in swarms_half(spec.group.subnet):
        raise InvalidRequest(
            f"environment {spec.name}: in a swarm {spec.group.address} is not free: Docker takes the upper half of a "
            "group's network for itself; give an address of the lower",
            field="containerData.groupIP",
        )


def swarms_half(subnet: str) -> IPv4Network:
    """The part of a group's network in which Swarm gives each task an address, that its agent then replaces."""
    return list(IPv4Network(subnet).subnets(prefixlen_diff=1))[1]


def needs(spec: EnvironmentSpec) -> str:
    """What an environment's agent has to know of it, for a label; nothing in it is a secret or a user's free text."""
    asked = spec.options
    options = ContainerData(disk=asked.disk, bandwidth=asked.bandwidth, io=asked.io)
    return msgspec.json.encode(replace(spec, token="", options=options)).decode()


def surroundings(spec: EnvironmentSpec, names: Names, settings: Mapping[str, str]) -> dict[str, str]:
    """What the Environment endpoint finds in its environment."""
    packages = package_path(places(Path(PACKAGES), spec.packages), settings)
    values = variables(spec, names.places, "", {**settings, **packages})
    return {key: _literal(value) for key, value in values.items()} | {"RCE_HOST": NODE}


def _literal(value: str) -> str:
    """A value as Swarm, which takes it for a template, shall give it on."""
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
    """One life of an environment. Swarm places it; it starts it never again, as a new life has a new token."""
    owner = f"uid={USER},gid={USER},mode=0700,nosuid,nodev"
    home = f"size={HOME_SIZE},nr_inodes={INODES},{owner}"
    sockets = f"size={SOCKETS_SIZE},nr_inodes={SOCKETS_INODES},noexec,{owner}"
    asked = spec.options
    return {
        "ContainerSpec": {
            "Image": image,
            "Args": list(command),
            "Env": [f"{key}={value}" for key, value in variables.items()],
            "Labels": {**labels, SPEC: needs(spec), **({EGRESS: spec.egress} if spec.egress != "none" else {})},
            "Hostname": spec.name.partition("/")[2][:LONGEST_HOSTNAME] if spec.group is not None else "",
            "User": f"{USER}:{USER}",
            "ReadOnly": True,
            "CapabilityDrop": ["ALL"],
            "Privileges": {"NoNewPrivileges": True},  # an older Docker does not know it; see `protected` of NodeReport
            "DNSConfig": {"Nameservers": [NO_NAMESERVER] if spec.egress == "none" else list(nameservers)},
            "Init": False,  # the image has its own
            "StopGracePeriod": STOP_TIMEOUT * NANO,
            "Ulimits": [
                {"Name": "nofile", "Soft": OPEN_FILES, "Hard": OPEN_FILES},
                {"Name": "core", "Soft": 0, "Hard": 0},
            ],
            "Mounts": [
                _volume(names.control, CONTROL, labels, read_only=True),
                _volume(names.sockets, SOCKETS, _platform(labels), sockets),
                _volume(names.home, HOME, labels, home),
                *([_volume(names.packages, PACKAGES, labels, read_only=True)] if spec.packages else []),
                _memory("/tmp", TEMPORARY_SIZE),
                _memory("/dev/shm", granted.memory),
                *(_bind(path, read_only=True) for path in read_only),
            ],
        },
        "Resources": {
            "Limits": {"NanoCPUs": int(granted.cpu * NANO), "MemoryBytes": granted.memory, "Pids": granted.pids},
            # What it asks for by number it finds where it is placed; slots alone are the task set's to count.
            "Reservations": {
                "NanoCPUs": int(asked.cpu * NANO),
                "MemoryBytes": int(asked.memory),
                "GenericResources": [{"DiscreteResourceSpec": {"Kind": GPU, "Value": asked.gpus}}][: asked.gpus],
            },
        },
        "RestartPolicy": {"Condition": "none"},
        "Placement": {"Constraints": list(constraints)},
        "Networks": [{"Target": network}],
        "LogDriver": {"Name": "json-file", "Options": {"max-size": LOG_SIZE, "max-file": "2"}},
    }


def agent_task(
    agent: AgentService, image: str, known: Mapping[str, str], labels: Mapping[str, str], root: str, tls: Tls | None
) -> Spec:
    """One agent on each node, in its network; `known` is what it is told of the task set and the Master.

    `root` is Docker's directory, and `tls` where each node has its own certificate, on all nodes alike.
    """
    variables = {
        **known,
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
            "CapabilityAdd": ["CAP_NET_ADMIN", "CAP_NET_RAW"],  # for its node's packet filter
            "Init": True,
            "StopGracePeriod": NANO,
            "Mounts": [
                _bind(DOCKER_SOCKET),
                # The sockets of environments are in memory, on mounts that Docker makes after the agent's own.
                {**_bind(f"{root}/volumes"), "BindOptions": {"Propagation": "rslave"}},
                _bind(f"{root}/containers"),  # with their files of names
                _memory("/tmp", TEMPORARY_SIZE),
                *(_bind(path, read_only=True) for path in mounts),
            ],
        },
        "RestartPolicy": {"Condition": "any", "Delay": NANO},
        "Networks": [{"Target": "host"}],
        "LogDriver": {"Name": "json-file", "Options": {"max-size": LOG_SIZE, "max-file": "2"}},
    }


def _platform(labels: Mapping[str, str]) -> dict[str, str]:
    return {key: value for key, value in labels.items() if key in ("rce.platform", "rce.directory")}


def _volume(name: str, target: str, labels: Mapping[str, str], memory: str = "", read_only: bool = False) -> Spec:
    driver = {"Name": "local", "Options": {"type": "tmpfs", "device": "tmpfs", "o": memory}} if memory else None
    options = {"NoCopy": True, "Labels": dict(labels), "DriverConfig": driver}
    return {"Type": "volume", "Source": name, "Target": target, "ReadOnly": read_only, "VolumeOptions": options}


def _memory(target: str, size: int) -> Spec:
    return {"Type": "tmpfs", "Target": target, "TmpfsOptions": {"SizeBytes": size, "Mode": 0o1777}}


def _bind(path: str, read_only: bool = False) -> Spec:
    return {"Type": "bind", "Source": path, "Target": path, "ReadOnly": read_only}

"""Settings of the Container task set."""

from __future__ import annotations

import os
import re
import socket
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal

from msgspec import Meta, Struct

from rce import __version__
from rce.control.client import addresses
from rce.errors import InvalidRequest

_HOST = re.compile(r"(?:tcp|ssl|tls):(?:host=)?((?:[^:\\]|\\.)*)")
EGRESS_POOL = "10.127.0.0/16"
NAMESERVERS = ("1.1.1.1", "9.9.9.9")


class Settings(Struct, frozen=True):
    """RCE Container task set: starts and stops the environments of one machine."""

    data_dir: Annotated[Path, Meta(description="directory for the data of this task set")]
    master: Annotated[
        str,
        Meta(description="control address of the Master, a Twisted client endpoint; of several: comma-separated"),
    ] = "tcp:127.0.0.1:8080"
    name: Annotated[str, Meta(description="name of this task set, unique on the platform; empty: the host's name")] = ""
    token: Annotated[
        str, Meta(description="one-time join token; set RCE_TOKEN rather than the command line, which others can see")
    ] = ""
    engine: Annotated[
        Literal["process", "docker", "swarm", "kubernetes"],
        Meta(
            description="engine of the environments: process, docker, swarm (DOCKER_HOST must be a manager of it) or "
            "kubernetes (the cluster that this program runs in, or that of KUBECONFIG)"
        ),
    ] = "process"
    image: Annotated[str, Meta(description="all but process: image of the environments")] = f"rce/mapping:{__version__}"
    agent_image: Annotated[str, Meta(description="swarm and kubernetes: image of the agent on each node")] = (
        f"rce/agent:{__version__}"
    )
    agent_address: Annotated[
        str,
        Meta(description="address at which agents of a swarm or cluster reach this task set; empty: a swarm manager's"),
    ] = ""
    agent_port: Annotated[
        int, Meta(ge=0, le=65535, description="kubernetes: port for agents; 0: a free one, which stays the same")
    ] = 0
    namespace: Annotated[str, Meta(description="kubernetes: namespace of agents and environments")] = "rce"
    namespace_per_user: Annotated[
        bool, Meta(description="kubernetes: environments of each user in a namespace of their own")
    ] = False
    pull_secrets: Annotated[
        list[str], Meta(description="kubernetes: secrets of the namespace with which nodes pull images")
    ] = []
    priority_class: Annotated[
        str, Meta(description="kubernetes: priority class of environments; empty: the default")
    ] = ""
    node_directory: Annotated[
        str, Meta(description="kubernetes: directory on each node for the sockets of environments")
    ] = "/var/lib/rce"
    seccomp_directory: Annotated[
        str, Meta(description="kubernetes: kubelet's directory of seccomp profiles on each node")
    ] = "/var/lib/kubelet/seccomp"
    egress_pool: Annotated[
        str, Meta(description="docker and swarm: network of which each environment with egress gets a /30")
    ] = EGRESS_POOL
    nameservers: Annotated[
        list[str],
        Meta(description="all but process: nameservers of such environments; empty: 1.1.1.1 and 9.9.9.9"),
    ] = []
    mounts: Annotated[
        list[str], Meta(description="all but process: directories that every environment sees read-only")
    ] = []
    data_host: Annotated[
        str, Meta(description="address on which data links from other machines are accepted; empty: none")
    ] = ""
    data_port: Annotated[int, Meta(ge=0, le=65535, description="port for data links; 0 takes a free one")] = 0
    data_address: Annotated[
        str, Meta(description="name or address at which other machines dial it; empty: data_host")
    ] = ""
    tls: Annotated[
        Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem, for TLS between machines")
    ] = None
    host: Annotated[str, Meta(description="identity of this machine; empty: detected")] = ""
    entry: Annotated[
        str, Meta(description="URLs of the Masters' HTTP entries, for users' packages; empty: on the hosts of `master`")
    ] = ""
    size: Annotated[int, Meta(ge=1, description="slots for environments on this machine")] = 10
    warm: Annotated[
        int, Meta(ge=0, le=100, description="process engine: endpoints that wait for environments, which start sooner")
    ] = 0
    gpus: Annotated[int, Meta(ge=0, description="docker engine: number of GPUs for environments")] = 0
    features: Annotated[list[str], Meta(description="special features of this machine, comma-separated")] = []
    package_path: Annotated[list[str], Meta(description="directories with ROS 2 packages, comma-separated")] = []
    typesupport: Annotated[str, Meta(description="directory with built type support of messages and services")] = ""
    allow_unisolated: Annotated[bool, Meta(description="process engine: serve a Master on another machine too")] = False
    allow_root: Annotated[bool, Meta(description="process engine: run the nodes of all users as root")] = False
    stop_environments: Annotated[
        bool, Meta(description="stop the environments at exit, else the next start adopts them")
    ] = False

    @property
    def own_name(self) -> str:
        """Name of the task set, by default that of the host."""
        return self.name or socket.gethostname()


def check_isolation(settings: Settings) -> None:
    """Check that the process engine, which does not isolate, serves only a Master on this machine, and not as root.

    Raises:
        InvalidRequest: Users from elsewhere could run programs as this user, or any user as root.
    """
    if settings.engine == "process" and not settings.allow_root and os.geteuid() == 0:
        raise InvalidRequest(
            "the process engine would run the nodes of all users as root: start it as another user, use another "
            "engine, or --allow-root",
            field="allow_root",
        )
    if settings.engine == "process" and not settings.allow_unisolated and not is_local(settings.master):
        raise InvalidRequest(
            f"the process engine runs users' programs as this user, so it serves a Master on this machine only, and "
            f"{settings.master} is not on a loopback address: use another engine, or --allow-unisolated",
            field="master",
        )


def host_of(description: str) -> str:
    """Return the host of a Twisted client endpoint; empty if it has none."""
    match = _HOST.match(description)
    return re.sub(r"\\(.)", r"\1", match[1]) if match else ""


def is_local(description: str) -> bool:
    """Return True if a Twisted client endpoint, or each of several, certainly leads to this machine."""
    if "," in description:
        return all(is_local(each) for each in addresses(description))
    if description.startswith("unix:"):
        return True
    host = host_of(description)
    try:
        return host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return False

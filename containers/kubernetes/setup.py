"""Settings of the engine `kubernetes` beside those that all containers of a task set share."""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from containers.settings import NAMESERVERS

SECCOMP = "/var/lib/kubelet/seccomp"  # where kubelet looks for profiles, unless its root is another


class AgentSetup(Struct, frozen=True, kw_only=True):
    """Settings of the agents.

    The task set listens for them on `port` (0: any free one) of all addresses, and they reach it at `address`. They
    accept data links from other machines on `data_port` of their node (0: any free one). `entry` is as in `Fetcher`.
    """

    image: str
    address: str
    port: int = 0
    data_port: int = 0
    entry: str = ""
    mounts: Sequence[str] = ()
    command: Sequence[str] = ("python3", "-P", "-m", "containers.kubernetes.agent")


class ClusterSetup(Struct, frozen=True, kw_only=True):
    """Settings by which a task set uses a cluster.

    Everything is in `namespace`, or with `per_user` the environments of each user are in one of their own, whose name
    begins with it. Nodes have the sockets of environments below `directory`; kubelet reads profiles of system calls in
    `seccomp`.
    """

    agent: AgentSetup
    namespace: str = "rce"
    per_user: bool = False
    pull_secrets: Sequence[str] = ()
    priority_class: str = ""
    nameservers: Sequence[str] = NAMESERVERS
    directory: str = "/var/lib/rce"
    seccomp: str = SECCOMP

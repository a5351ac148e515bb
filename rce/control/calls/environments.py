"""Calls between the Master and task sets about environments."""

from __future__ import annotations

from msgspec import Struct

from rce.api.egress import Egress
from rce.control.calls.call import Call, Nothing
from rce.protocol.messages import ContainerData


class Group(Struct, frozen=True):
    """Network group of an environment. `name` is `userID/group`; `members` are addresses by containerTag."""

    name: str
    subnet: str  # as 10.128.0.0/24, unique in the platform
    address: str  # of the environment, in the subnet
    members: dict[str, str] = {}  # at present, with this environment; others may join later


class EnvironmentSpec(Struct, frozen=True):
    """Environment to run. `name` is `userID/containerTag`; `run` (32 hex digits) identifies this start of it."""

    name: str
    run: str
    token: str  # one-time join token of its Environment endpoint
    options: ContainerData
    group: Group | None = None
    packages: list[str] = []  # digests of its user packages; if two have the same ROS package, the first one counts
    egress: Egress = "none"


class StartEnvironment(Call[Nothing], frozen=True):
    """Start an environment; answered when its process or container runs. Its endpoint then joins the Master."""

    timeout = 180.0  # users' packages are fetched, and images pulled
    environment: EnvironmentSpec


class StopEnvironment(Call[Nothing], frozen=True):
    """Stop an environment and remove everything that belongs to it; answered when it is gone."""

    timeout = 120.0
    name: str


class KeepEnvironments(Call[Nothing], frozen=True):
    """Keep only the environments with these runs; stop and remove all others."""

    timeout = 300.0  # all environments of the machine may have to be stopped
    runs: list[str]


class SetRelays(Call[Nothing], frozen=True):
    """Set the data relays of all machines, as HOST:PORT. Environments may connect to these relays only."""

    relays: list[str]


class ReportRelays(Call[Nothing], frozen=True):
    """Report the data relays of a task set that has several hosts: HOST:PORT by host, as in its Hello."""

    relays: dict[str, str]


class EnvironmentDied(Call[Nothing], frozen=True):
    """Report that an environment of this task set ended by itself or did not start."""

    name: str
    run: str
    reason: str


class LimitReached(Call[Nothing], frozen=True):
    """Report that an environment of this task set reached a limit but is still running."""

    name: str
    run: str
    reason: str


class DownloadTicket(Struct, frozen=True):
    """Permission to download an archive once, within a short time, from the Master's HTTP entry.

    `path` is requested with `token` as bearer token. `scheme` and `port` are those of the entry; its host is the host
    of the Master. `size` is that of the archive.
    """

    scheme: str
    port: int
    path: str
    token: str
    size: int


class FetchPackage(Call[DownloadTicket], frozen=True):
    """Request the archive of a user package that an environment of this task set needs. Raises NotFound."""

    digest: str

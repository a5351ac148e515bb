"""Environments: what the Master asks of task sets, and what they report and fetch."""

from __future__ import annotations

from typing import Literal

from msgspec import Struct

from rce.calls.call import Call, Nothing
from rce.messages import ContainerData


class Group(Struct, frozen=True):
    """The network group of an environment. `name` is `userID/group`; `members` are addresses by containerTag."""

    name: str
    subnet: str  # as 10.128.0.0/24; no other group of the platform has it
    address: str  # of the environment, in the subnet
    members: dict[str, str] = {}  # all of now, this one too; others may come later


Egress = Literal["none", "internet", "all"]
"""What of the network an environment reaches besides its group: nothing; the internet without private and link-local
networks, metadata of clouds, and its host; or all of it."""


class EnvironmentSpec(Struct, frozen=True):
    """An environment to run. `name` is `userID/containerTag`; `run` (32 hex) tells its lives apart."""

    name: str
    run: str
    token: str  # one-time join token of its Environment endpoint
    options: ContainerData
    group: Group | None = None
    packages: list[str] = []  # digests of the users' packages that it sees, first come first found
    egress: Egress = "none"


class StartEnvironment(Call[Nothing], frozen=True):
    """Start an environment; answered when its process or container runs. Its endpoint joins the Master by itself."""

    environment: EnvironmentSpec


class StopEnvironment(Call[Nothing], frozen=True):
    """Stop an environment and remove all that it left; answered when nothing of it remains."""

    name: str


class KeepEnvironments(Call[Nothing], frozen=True):
    """Stop and remove every environment whose run is not among these."""

    runs: list[str]


class KnowRelays(Call[Nothing], frozen=True):
    """The data relays of all machines, HOST:PORT: to these, and no others, environments here may be taken."""

    relays: list[str]


class EnvironmentDied(Call[Nothing], frozen=True):
    """An environment of this task set ended by itself or did not come up."""

    name: str
    run: str
    reason: str


class LimitReached(Call[Nothing], frozen=True):
    """An environment of this task set runs on, but a limit took something of it."""

    name: str
    run: str
    reason: str


class Ticket(Struct, frozen=True):
    """What an archive is fetched with, once and soon: `path` at the Master's entry, with the token as bearer's.

    `scheme` and `port` are those of the entry, whose host is where the Master is.
    """

    scheme: str
    port: int
    path: str
    token: str
    size: int


class FetchPackage(Call[Ticket], frozen=True):
    """A task set, or its agent, lacks an archive that an environment of its own needs. NotFound."""

    digest: str

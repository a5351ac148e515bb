"""Calls between a task set and its agents, one on each node of a swarm or cluster."""

from __future__ import annotations

from msgspec import Struct

from rce.control.calls.call import Call, Nothing
from rce.control.calls.environments import EnvironmentSpec
from rce.errors import ErrorInfo


class NodeReport(Call[Nothing], frozen=True):
    """Report the state of an agent's node, after each join and whenever it changes."""

    runs: list[str]  # of the environments that run there and are fully set up
    images: dict[str, str]  # id by tag, of the images for this version
    protected: bool  # True if Docker runs containers with no-new-privileges by default
    relay: str  # HOST:PORT of the data relay of the node


class ContainerEnded(Call[Nothing], frozen=True):
    """Report that the container of an environment has ended, for whatever reason."""

    run: str
    reason: str
    status: int
    lines: list[str]


class EnvironmentUnusable(Call[Nothing], frozen=True):
    """Report that an environment cannot be set up on its node, where its container waits without running anything."""

    run: str
    error: ErrorInfo


class PullImage(Call[Nothing], frozen=True):
    """Let the node's Docker pull an image from the task set's registry and tag it; answered when it is there.

    Raises StartFailed.
    """

    timeout = 3600.0
    tag: str
    source: str  # REPOSITORY@DIGEST
    user: str
    secret: str


class SetGroupMembers(Call[Nothing], frozen=True):
    """Set the members of the network group `userID/group`: addresses by containerTag."""

    name: str
    members: dict[str, str]


class SetMaster(Call[Nothing], frozen=True):
    """Set the control address of the Master that leads, a Twisted client endpoint."""

    master: str


class RemovedRun(Struct, frozen=True):
    """Result of RemoveRun; `found` is true if there was a container."""

    found: bool


class RemoveRun(Call[RemovedRun], frozen=True):
    """Stop the container of an environment and remove everything that belongs to it; answered when it is gone."""

    timeout = 120.0
    run: str


class Furnish(Call[Nothing], frozen=True):
    """Confine an environment whose container runs on the agent's node, and open its sockets; answered when it is done.

    Its endpoint waits until then. Raises InvalidRequest, StartFailed and NotFound.
    """

    timeout = 170.0  # users' packages are fetched
    environment: EnvironmentSpec  # without its token
    container: str  # id in the node's runtime
    memory: int  # its limit in bytes


class ConnectGroup(Call[Nothing], frozen=True):
    """Connect an environment to the others of its network group, and to no others."""

    run: str
    members: dict[str, str]  # addresses in the group by containerTag, for its hosts file
    peers: list[str]  # addresses of the other members' pods

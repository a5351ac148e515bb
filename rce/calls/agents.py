"""Between a task set and its agents, one on each node of a swarm."""

from __future__ import annotations

from msgspec import Struct

from rce.calls.call import Call, Nothing
from rce.errors import ErrorInfo


class NodeReport(Call[Nothing], frozen=True):
    """What is on an agent's node: said after each join and when it changes."""

    runs: list[str]  # of the environments that run there with all that they need
    images: dict[str, str]  # id by tag, of those for this version
    protected: bool  # whether its Docker gives containers no new privileges
    relay: str  # where data links to environments there are taken, HOST:PORT


class ContainerEnded(Call[Nothing], frozen=True):
    """The container of an environment has ended, whoever ended it."""

    run: str
    reason: str
    status: int
    lines: list[str]


class Unfit(Call[Nothing], frozen=True):
    """An environment lacks what it asked for on the node where it was placed, and so does nothing there."""

    run: str
    error: ErrorInfo


class HaveImage(Call[Nothing], frozen=True):
    """Have the node's Docker take an image from the task set, and call it so; answered when it has. StartFailed."""

    tag: str
    source: str  # REPOSITORY@DIGEST
    user: str
    secret: str


class KnowGroup(Call[Nothing], frozen=True):
    """The members of a network group, `userID/group`: addresses by containerTag."""

    name: str
    members: dict[str, str]


class Cleared(Struct, frozen=True):
    """Nothing of an environment is there any more; `found` if there was a container of it."""

    found: bool


class ClearRun(Call[Cleared], frozen=True):
    """Stop the container of an environment and remove all that it left; answered when nothing of it is there."""

    run: str

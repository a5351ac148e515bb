"""The platform's own processes on its machines, and how machines are invited."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from rce.joining import Role
from rce.views.resources import Usage

MachineName = Annotated[str, Meta(pattern="^[A-Za-z0-9]+(-[A-Za-z0-9]+)*$", max_length=63)]


class MachineView(Struct, frozen=True):
    """A process of the platform that other things run at: a task set (`container`), a Robot endpoint, a service.

    `away`: it has lost the Master, and its time to come back runs; `gone`: that time is over.
    """

    name: str
    role: Literal["container", "robot", "service"]
    state: Literal["joined", "away", "gone"]
    host: str  # identity of the machine: processes of one host have the same
    url: str  # where it is reached, empty for a task set
    slots: int  # that environments may take
    used: int  # slots that environments have
    gpus: int
    gpusUsed: int
    features: list[str]
    environments: int
    robots: int
    usage: Usage | None = None  # of its environments together


class NewInvitation(Struct, frozen=True, forbid_unknown_fields=True):
    """A machine that shall join. `address` is by which others reach it; empty: the one that it comes from."""

    name: MachineName
    roles: Annotated[list[Role], Meta(min_length=1)] = field(default_factory=lambda: ["robot", "container"])
    address: Annotated[str, Meta(max_length=255)] = ""
    hours: Annotated[float, Meta(gt=0, le=24 * 365, description="for which the code is good")] = 24.0


class Invited(Struct, frozen=True):
    """The join code: it is shown this once, and good for one machine, once, until `expires`."""

    name: str
    code: str
    expires: float

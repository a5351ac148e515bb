"""Types of the platform's processes on its machines and of machine invitations."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from rce.api.joining import Role
from rce.api.views.resources import Usage

# In Python, `$` alone also matches before a newline at the end.
MachineName = Annotated[str, Meta(pattern=r"^[A-Za-z0-9]+(-[A-Za-z0-9]+)*$(?!\n)", max_length=63)]


class MachineView(Struct, frozen=True):
    """Process of the platform that hosts resources: a task set (`container`), a Robot endpoint or a service.

    `away`: it has lost the Master and is within its grace period; `gone`: the grace period is over.
    """

    name: str
    role: Literal["container", "robot", "service"]
    state: Literal["joined", "away", "gone"]
    host: str  # id of the machine, the same for all its processes
    url: str  # where robots or clients reach it; empty for a task set
    slots: int  # for environments
    used: int  # slots that environments occupy
    gpus: int
    gpusUsed: int
    features: list[str]
    environments: int
    robots: int
    usage: Usage | None = None  # sum over its environments
    addresses: list[str] = []  # hosts at which others reach it


class ServiceView(Struct, frozen=True):
    """Service that has joined, and the URL of its API, which takes the same credentials."""

    name: str
    url: str


class NewInvitation(Struct, frozen=True, forbid_unknown_fields=True):
    """Machine to invite. `address` is the one for other machines; empty for the one from which it connects."""

    name: MachineName
    roles: Annotated[list[Role], Meta(min_length=1)] = field(default_factory=lambda: ["robot", "container"])
    address: Annotated[str, Meta(max_length=255)] = ""
    hours: Annotated[float, Meta(gt=0, le=24 * 365, description="validity of the join code")] = 24.0


class Invited(Struct, frozen=True):
    """Join code: shown only once, and valid for one machine, once, until `expires`."""

    name: str
    code: str
    expires: float

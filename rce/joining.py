"""How a machine comes to the platform: an invitation from the Master, carried by hand as one join code.

The new machine makes a key, and sends a certificate request with its invitation to the Master, over TLS with the
authority whose fingerprint is in the code. It gets its certificate and one-time join tokens for its processes.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
from typing import Literal

import msgspec
from msgspec import Struct

from rce.errors import InvalidRequest

Role = Literal["robot", "container"]
PREFIX = "rce1-"


class Invitation(Struct, frozen=True):
    """One machine may join once, until `expires` (seconds since 1970).

    The Master keeps nothing but the digest, so what stands here is as the Master wrote it.
    """

    name: str
    roles: list[Role]
    expires: int
    secret: str
    address: str = ""  # by which other machines reach it; empty: the one that it comes from

    @property
    def digest(self) -> str:
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()


class JoinCode(Struct, frozen=True):
    """Where to present an invitation, and by what to know that it is the right place."""

    url: str
    authority: str  # SHA-256 of its certificate
    invitation: Invitation

    def text(self) -> str:
        return PREFIX + base64.urlsafe_b64encode(msgspec.json.encode(self)).decode().rstrip("=")


class Application(Struct, frozen=True):
    """What a new machine sends; `request` is a PEM certificate request."""

    invitation: Invitation
    request: str
    version: str


class Membership(Struct, frozen=True):
    """What it gets: PEM certificates, the control address of the Master, its own address, tokens and names by role."""

    certificate: str
    master: str
    address: str
    tokens: dict[Role, str]
    names: dict[Role, str]


def parse(text: str) -> JoinCode:
    """InvalidRequest if it is no join code."""
    body = text.strip().removeprefix(PREFIX)
    try:
        return msgspec.json.decode(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)), type=JoinCode)
    except (binascii.Error, ValueError, msgspec.DecodeError):
        raise InvalidRequest(
            "this is no join code, or not all of it: paste the whole line that `provision machine add` printed"
        ) from None


def process_name(machine: str, role: Role) -> str:
    """Names of processes are unique on the platform, and a machine has one process of each role."""
    return machine if role == "container" else f"{machine}-{role}"

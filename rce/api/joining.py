"""Enrolment of machines: an invitation from the Master, which the administrator carries over as a join code.

The new machine makes a private key and sends a certificate request with its invitation to the Master, over TLS with the
certificate authority whose fingerprint is in the join code. It gets its certificate, and one-time join tokens for its
processes.
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
    """Permission for one machine to join once, until `expires` (seconds since 1970).

    The Master stores only the digest, which therefore covers everything that is in the invitation.
    """

    name: str
    roles: list[Role]
    expires: int
    secret: str
    address: str = ""  # address for other machines; empty: the one from which it connects

    @property
    def digest(self) -> str:
        """SHA-256 of the invitation."""
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()


class JoinCode(Struct, frozen=True):
    """Invitation with the URL of the Master and the fingerprint by which its authority is verified."""

    url: str
    authority: str  # SHA-256 of its certificate
    invitation: Invitation

    def text(self) -> str:
        """Return the code as one line of text."""
        return PREFIX + base64.urlsafe_b64encode(msgspec.json.encode(self)).decode().rstrip("=")


class JoinRequest(Struct, frozen=True):
    """Request of a new machine; `request` is a PEM certificate request."""

    invitation: Invitation
    request: str
    version: str


class Membership(Struct, frozen=True):
    """Response to a join request.

    PEM certificates, the Master's control address, the machine's own address, and join tokens and process names by
    role.
    """

    certificate: str
    master: str
    address: str
    tokens: dict[Role, str]
    names: dict[Role, str]


def parse_join_code(text: str) -> JoinCode:
    """Parse a join code.

    Raises:
        InvalidRequest: The text is not a complete join code.
    """
    body = text.strip().removeprefix(PREFIX)
    try:
        return msgspec.json.decode(base64.urlsafe_b64decode(body + "=" * (-len(body) % 4)), type=JoinCode)
    except (binascii.Error, ValueError, msgspec.DecodeError):
        raise InvalidRequest(
            "this is not a complete join code: paste the whole line that `provision machine add` printed"
        ) from None


def process_name(machine: str, role: Role) -> str:
    """Return the name of a machine's process, unique on the platform: a machine has one process of each role."""
    return machine if role == "container" else f"{machine}-{role}"


def sibling_name(endpoint: str, number: int) -> str:
    """Return the name of a further process of a Robot endpoint. No name of a machine has a dot."""
    return f"{endpoint}.{number}"

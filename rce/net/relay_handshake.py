"""Handshake of data relays.

The relay of a machine accepts data links for the environments of the machine, which have no network. The first line of
a caller, a RelayRequest as JSON, names an environment; the relay forwards all later bytes in both directions. To refuse
a caller, the relay sends as many bytes as an endpoint's greeting has: the caller waits for that greeting, and so reads
the reason.
"""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec import Struct

from rce.errors import MALFORMED, InvalidRequest

GREETING_SIZE = 20  # bytes; see endpoints/data/port.py
MAX_REQUEST_LENGTH = 1024
_REFUSAL_PREFIX = b"RCE!"
RefusalReason = Literal[
    "not understood", "not here", "another user's", "no such relay", "out of reach", "too many links"
]


class RelayRequest(Struct, frozen=True, omit_defaults=True):
    """First line of a caller: the destination of a data link.

    Attributes:
        to: The environment, as `user/tag`.
        relay: HOST:PORT of the relay of that environment's machine; only in requests to the caller's own relay.
        user: User of the calling environment; only in requests between relays. Empty if a Robot endpoint calls.
    """

    to: str
    relay: str = ""
    user: str = ""

    def line(self) -> bytes:
        """Return the encoded line."""
        return msgspec.json.encode(self) + b"\n"

    @staticmethod
    def parse(line: bytes) -> RelayRequest:
        """Decode the first line of a caller.

        Raises:
            InvalidRequest: The line is malformed.
        """
        try:
            return msgspec.json.decode(line, type=RelayRequest)
        except MALFORMED as error:
            raise InvalidRequest(f"the first line to a relay is malformed: {error}") from None


def encode_refusal(reason: RefusalReason) -> bytes:
    """Return the bytes that a relay sends before it closes the connection of a refused caller."""
    return _REFUSAL_PREFIX + reason.encode().ljust(GREETING_SIZE - len(_REFUSAL_PREFIX))


def refusal_reason(greeting: bytes) -> str:
    """Return the reason if `greeting` is the refusal of a relay, else an empty string."""
    return (
        greeting[len(_REFUSAL_PREFIX) :].decode("ascii", "replace").strip()
        if greeting.startswith(_REFUSAL_PREFIX)
        else ""
    )


def parse_relay_address(address: str) -> RelayRequest:
    """Parse `HOST:PORT/user/tag`, the part of an address after `relay:`.

    Raises:
        ValueError: The address names no environment.
    """
    relay, slash, to = address.partition("/")
    if not slash:
        raise ValueError(f"relay address {address!r} names no environment")
    return RelayRequest(to, relay)

"""What a caller says to a relay, and how the relay refuses.

The relay of a machine takes data links for the environments there, which have no network. A caller's first line, a
Passage as JSON, names one of them; all that follows is passed on, and so is all that comes back. A relay that refuses
answers what is as long as an endpoint's greeting, so that its caller, who waits for that greeting, can read the reason.
"""

from __future__ import annotations

from typing import Literal

import msgspec
from msgspec import Struct

from rce.errors import InvalidRequest

GREETING = 20  # bytes; see endpoints/data_port.py
LONGEST = 1024
_REFUSED = b"RCE!"
Reason = Literal["not understood", "not here", "another user's", "no such relay", "out of reach", "too many links"]


class Passage(Struct, frozen=True, omit_defaults=True):
    """Where a data link leads."""

    to: str  # environment, as user/tag
    relay: str = ""  # HOST:PORT of the relay of its machine, said to one's own machine's relay
    user: str = ""  # whose environment calls, said by one relay to the other; empty: a Robot endpoint calls

    def line(self) -> bytes:
        """The first line of the caller."""
        return msgspec.json.encode(self) + b"\n"

    @staticmethod
    def parse(line: bytes) -> Passage:
        """InvalidRequest."""
        try:
            return msgspec.json.decode(line, type=Passage)
        except msgspec.DecodeError as error:
            raise InvalidRequest(f"the first line to a relay: {error}") from None


def refusal(reason: Reason) -> bytes:
    """What the relay answers before it closes the connection."""
    return _REFUSED + reason.encode().ljust(GREETING - len(_REFUSED))


def refused(greeting: bytes) -> str:
    """The reason, if this is a relay's refusal, else an empty string."""
    return greeting[len(_REFUSED) :].decode("ascii", "replace").strip() if greeting.startswith(_REFUSED) else ""


def split(address: str) -> Passage:
    """`HOST:PORT/user/tag`, which stands in an address after `relay:`. ValueError."""
    relay, slash, to = address.partition("/")
    if not slash:
        raise ValueError(f"relay address {address!r} names no environment")
    return Passage(to, relay)

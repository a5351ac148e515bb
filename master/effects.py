"""What the graph asks the Master's rim to do. Nothing here waits or knows a socket."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from master.records import Parameter
from rce.calls.call import Call


class Send(Struct, frozen=True):
    """Make a call at a process. Sends with one `key` (what they are about) reach one process in their order.

    An empty key is about all that the process has: what is sent to it later waits until this call is answered.
    """

    to: str
    call: Call[Any]
    key: str


class Settle(Struct, frozen=True):
    """What this key names is real now: whoever waits for it may go on."""

    key: str


Sequence = list[Send | Settle]
"""Steps one after the other; the first failure ends it. Who is away misses its steps, and then nothing is settled."""

Plan = list[Sequence]
"""Sequences that run beside each other."""


class Outcome(Struct, frozen=True):
    """What a command leads to. It is complete when the plan is carried out and all of `awaits` are real."""

    plan: Plan
    awaits: list[str] = []
    replaced: Parameter | None = None  # what stood there before; it comes back if the new one is refused

"""Effects of commands: the calls that the Master makes at processes. Plain data; nothing here waits or does I/O."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from master.graph.catalogue_records import Use
from master.graph.records import Parameter, Ref
from rce.control.calls.call import Call
from rce.protocol.messages import UsedService


class Send(Struct, frozen=True):
    """A control call at a process.

    Calls with the same `about` reach one process in the order in which their plans were made. Without `about` a call
    is about everything that the process has: later calls to this process wait until it is answered. A call is not made
    if `unless` is ready by then.
    """

    to: str
    call: Call[Any]
    about: Ref | None
    unless: Ref | None = None


class MarkReady(Struct, frozen=True):
    """Step that marks a reference ready and wakes who waits for it."""

    ref: Ref


Sequence = list[Send | MarkReady]
"""Steps in order; the first failure ends them. If a process is away and misses a call, nothing is marked ready."""

Plan = list[Sequence]
"""Sequences that run concurrently."""


class Outcome(Struct, frozen=True):
    """Result of a command: it is complete when `plan` has run and everything in `awaits` and `needs` is ready.

    If the command fails, what is in `awaits` is taken back, and so is the `use` that it began; what is in `needs` is
    not. `follows` runs as well, but the command neither waits for it nor fails with it. `service` is its answer.
    """

    plan: Plan
    awaits: list[Ref] = []
    parameter: Parameter | None = None  # as the command set it
    replaced: Parameter | None = None  # the one before it; restored if the new value is refused
    follows: Plan = []
    needs: list[Ref] = []
    use: Use | None = None
    service: UsedService | None = None

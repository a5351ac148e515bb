"""`trace`: messages hop by hop."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import pairwise

import msgspec

from rce import views
from rce.console.command import JSON, OF, Command, argument
from rce.console.session import Session

WAY = ("entered", "sent", "received", "delivered")
BACK = tuple(f"{hop} back" for hop in WAY)
STEPS = (*WAY, *BACK)[1:]
CLOCKS = "The steps between two machines are by two clocks, and as right as these agree."
Row = dict[str, float]
"""Microseconds of each step that is known, and of all of them as `total`."""


def trace(session: Session, words: argparse.Namespace) -> None:
    owner, _, interface = words.interface.partition("/")
    path = ("interfaces", owner, interface, "trace")
    rows: list[Row] = []
    hosts: set[str] = set()
    for event in session.api.follow(*path, follow=True, messages=words.count, user=words.of):
        if words.json:
            print(event.data, flush=True)
            continue
        message = msgspec.json.decode(event.data, type=views.MessageTrace)
        hosts |= {hop.host for hop in message.hops}
        for to, row in paths(message):
            if not rows:
                print(_line("MESSAGE", "TO", [step.upper() for step in STEPS], "TOTAL µs"))
            rows.append(row)
            _print(message.message, to, row)
    if rows:
        _print("median", f"of {len(rows)}", medians(rows))
    if len(hosts) > 1:
        print(CLOCKS)


def paths(message: views.MessageTrace) -> Iterator[tuple[str, Row]]:
    """How long each step took, for each interface that the message went to."""
    times: dict[tuple[str, str], float] = {}
    for hop in message.hops:
        times.setdefault((hop.interface, hop.hop), hop.time)
    for other in dict.fromkeys(hop.interface for hop in message.hops if hop.interface != message.source):
        there, back = (message.source, message.source, other, other), (other, other, message.source, message.source)
        way = [(step, times.get((place, hop))) for step, place, hop in zip(WAY, there, WAY, strict=True)]
        way += [(step, times.get((place, hop))) for step, place, hop in zip(BACK, back, WAY, strict=True)]
        row = {
            step: (time - before) * 1e6
            for (_, before), (step, time) in pairwise(way)
            if time is not None and before is not None
        }
        known = [time for _, time in way if time is not None]
        yield other, row | {"total": (known[-1] - known[0]) * 1e6}


def medians(rows: Sequence[Row]) -> Row:
    """Of each step, over the rows that have it."""
    import statistics  # for this command alone

    known = {step: [row[step] for row in rows if step in row] for step in (*STEPS, "total")}
    return {step: statistics.median(values) for step, values in known.items() if values}


def _print(message: str, to: str, row: Row) -> None:
    cells = [f"{row[step]:.0f}" if step in row else "-" for step in (*STEPS, "total")]
    print(_line(message, to, cells[:-1], cells[-1]), flush=True)


def _line(message: str, to: str, steps: Sequence[str], total: str) -> str:
    cells = (f"{step:>{max(9, len(name))}}" for name, step in zip(STEPS, steps, strict=True))
    return f"{message[:12]:12} {to[:24]:24} {' '.join(cells)} {total:>9}"


COMMANDS = (
    Command(
        "trace",
        "Follow the messages of an interface hop by hop, with the microseconds of each step.",
        trace,
        (
            argument("interface", live="interface", metavar="ENDPOINT/INTERFACE", help="of a robot or an environment"),
            argument("-n", "--count", type=int, default=10, metavar="N", help="messages (default: %(default)s)"),
            OF,
            JSON,
        ),
        ("trace scout/camera", "trace brain/pose -n 100"),
    ),
)

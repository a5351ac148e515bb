"""`trace`: times of messages at each hop between interfaces."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from shutil import get_terminal_size

import msgspec

from rce.api import views
from rce.cli.arguments import JSON, OF_USER, argument
from rce.cli.command import Command
from rce.cli.session import ConsoleSession
from rce.protocol.names import split_interface

FORWARD = ("entered", "sent", "received", "delivered")
BACK = tuple(f"{hop} back" for hop in FORWARD)
STEPS = (*FORWARD, *BACK)[1:]
STEP_WIDTHS = tuple(max(9, len(step)) for step in STEPS)
CLOCK_WARNING = "Steps between machines compare two clocks: they are as accurate as the clocks are synchronised."
Row = dict[str, float]
"""Microseconds of each known step, and from the first to the last as `total`."""


def trace(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Print the steps of an interface's next messages, and their medians."""
    owner, interface = split_interface(args.interface, "interface")
    path = ("interfaces", owner, interface, "trace")
    rows: list[Row] = []
    hosts: set[str] = set()
    for event in session.api.follow(*path, follow=True, messages=args.count, user=args.of):
        if args.json:
            print(event.data, flush=True)
            continue
        message = msgspec.json.decode(event.data, type=views.MessageTrace)
        hosts |= {hop.host for hop in message.hops}
        for to, row in paths(message):
            if not rows:
                print(_line("MESSAGE", "TO", [step.upper() for step in STEPS], "TOTAL µs"))
            rows.append(row)
            _print_row(message.message, to, row)
    if rows:
        _print_row("median", f"of {len(rows)}", medians(rows))
    if len(hosts) > 1:
        print(CLOCK_WARNING)


def paths(message: views.MessageTrace) -> Iterator[tuple[str, Row]]:
    """Yield the durations of the steps to each interface that received the message, with its name."""
    times: dict[tuple[str, str], float] = {}
    for hop in message.hops:
        times.setdefault((hop.interface, hop.hop), hop.time)
    for other in dict.fromkeys(hop.interface for hop in message.hops if hop.interface != message.source):
        there, back = (message.source, message.source, other, other), (other, other, message.source, message.source)
        steps = [(step, times.get((place, hop))) for step, place, hop in zip(FORWARD, there, FORWARD, strict=True)]
        steps += [(step, times.get((place, hop))) for step, place, hop in zip(BACK, back, FORWARD, strict=True)]
        row = {
            step: (time - before) * 1e6
            for (_, before), (step, time) in pairwise(steps)
            if time is not None and before is not None
        }
        known = [time for _, time in steps if time is not None]
        yield other, row | {"total": (known[-1] - known[0]) * 1e6}


def medians(rows: Sequence[Row]) -> Row:
    """Return the median of each step over the rows that have it."""
    import statistics  # slow

    known = {step: [row[step] for row in rows if step in row] for step in (*STEPS, "total")}
    return {step: statistics.median(values) for step, values in known.items() if values}


def _print_row(message: str, to: str, row: Row) -> None:
    cells = [f"{row[step]:.0f}" if step in row else "-" for step in (*STEPS, "total")]
    print(_line(message, to, cells[:-1], cells[-1]), flush=True)


def _line(message: str, to: str, steps: Sequence[str], total: str) -> str:
    """Return a line of the table; on a terminal that is too narrow, the steps back are on a second line."""
    cells = [f"{step:>{width}}" for width, step in zip(STEP_WIDTHS, steps, strict=True)]
    start, end = f"{message[:12]:12} {to[:24]:24}", f"{total:>9}"
    line = " ".join([start, *cells, end])
    if not sys.stdout.isatty() or len(line) <= get_terminal_size().columns:
        return line
    there = len(FORWARD) - 1
    line = " ".join([start, *cells[:there], end])
    return line if {*steps[there:]} == {"-"} else f"{line}\n{' '.join(cells[there:]):>{len(line)}}"


COMMANDS = (
    Command(
        "trace",
        "Follow the messages of an interface hop by hop, with the microseconds of each step.",
        trace,
        (
            argument(
                "interface", completion="interface", metavar="ENDPOINT/INTERFACE", help="of a robot or an environment"
            ),
            argument("-n", "--count", type=int, default=10, metavar="N", help="messages (default: %(default)s)"),
            OF_USER,
            JSON,
        ),
        ("trace scout/camera", "trace brain/pose -n 100"),
    ),
)

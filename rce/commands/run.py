"""`rce run`: a robot described in a file."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import signal
import sys
from pathlib import Path

from rce.client.robotfile import run_file


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(
        prog="rce run",
        description="Be the robot that FILE describes: create its environments, nodes, interfaces and connections, "
        "and take them away at the end (Ctrl-C).",
        epilog='Messages that come to the robot are printed as lines {"iTag": ..., "msg": ...}; lines of this form on '
        "standard input are sent.",
    )
    whole.add_argument("file", type=Path, metavar="FILE", help="JSON as that of the original's rce-ros, or YAML")
    return whole


def main(arguments: list[str]) -> int:
    words = parser().parse_args(arguments)
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    asyncio.run(run(words.file))
    return 0


async def run(file: Path) -> None:
    task = asyncio.current_task()
    assert task is not None
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await run_file(file)

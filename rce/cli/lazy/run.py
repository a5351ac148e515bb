"""Implementation of `rce run`."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import signal
import sys
from pathlib import Path

from rce.cli.session import ConsoleSession
from rce.client.robotfile import run_file


def run(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Run the robot of a file until SIGINT or SIGTERM."""
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    asyncio.run(_run_until_signal(args.file))


async def _run_until_signal(file: Path) -> None:
    task = asyncio.current_task()
    assert task is not None
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await run_file(file)

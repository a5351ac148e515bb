"""Platforms that a command uses: a running one, or one that it starts for itself."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import tempfile
from collections import deque
from collections.abc import AsyncIterator, Iterable, Iterator
from pathlib import Path
from typing import IO

import msgspec
from msgspec import Struct

from rce.cli.arguments import DEV_USER
from rce.cli.contexts import Access, running_platform
from rce.errors import InternalError, StartFailed
from rce.process import up
from rce.process.ready import Ready

LOG_LINES = 20  # printed when a started program fails


class _Entry(Struct):
    """Line of a log."""

    level: str
    message: str


@contextlib.asynccontextmanager
async def platform(args: argparse.Namespace) -> AsyncIterator[Access]:
    """Give access to the running platform of --url, or to a new one that ends with the context."""
    if args.url:
        yield running_platform(args)
        return
    print("starting a platform for this command alone; --url takes a running one", file=sys.stderr)
    with tempfile.TemporaryDirectory(prefix="rce-") as directory:
        async with own_platform(Path(directory), args.engine) as entry:
            yield Access(entry.url, DEV_USER, DEV_USER, None)


@contextlib.asynccontextmanager
async def own_platform(
    directory: Path, engine: str, size: int = 10, robot_processes: int = 1, warm: int = 0
) -> AsyncIterator[Ready]:
    """Run a new platform that ends with the context.

    Args:
        directory: Directory for its data.
        engine: Engine of the environments.
        size: Slots for environments.
        robot_processes: Processes of the Robot endpoint; they may be ready a moment later than the platform.
        warm: Number of prepared environments.
    """
    with programs_log() as log:
        settings = up.Settings(
            data_dir=directory,
            http_port=0,
            dev=True,
            engine=engine,  # type: ignore[arg-type]
            size=size,
            robot_processes=robot_processes,
            warm=warm,
            allow_root=True,  # its only user is the one who runs the command
        )
        entry: asyncio.Future[Ready] = asyncio.get_running_loop().create_future()

        async def started(ready: Ready) -> None:
            entry.set_result(ready)
            await asyncio.Event().wait()

        running = asyncio.create_task(up.run(settings, started, log))
        try:
            await asyncio.wait([running, entry], return_when=asyncio.FIRST_COMPLETED)  # type: ignore[type-var]
            if not entry.done():
                await running  # raises the reason why it did not start
            yield entry.result()
        finally:
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running


@contextlib.contextmanager
def programs_log() -> Iterator[IO[str]]:
    """Open a file for the log of started programs; print its last lines when they fail."""
    with tempfile.TemporaryFile("w+") as log:
        try:
            yield log
        except (StartFailed, InternalError) as error:
            log.seek(0)
            lines = deque(log, LOG_LINES)
            sys.stderr.writelines(lines)
            reason = _last_error(lines)
            raise type(error)(f"{error}: {reason}" if reason else str(error)) from None


def _last_error(lines: Iterable[str]) -> str:
    """Return the message of the last error in a log, or nothing if there is none."""
    reason = ""
    for line in lines:
        with contextlib.suppress(msgspec.DecodeError):
            entry = msgspec.json.decode(line, type=_Entry)
            reason = entry.message if entry.level in ("error", "critical") else reason
    return reason

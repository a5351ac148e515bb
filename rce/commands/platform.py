"""Where a command finds its platform: one that runs already, or one that it starts for itself."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import sys
import tempfile
from collections import deque
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

from rce import contexts, up
from rce.contexts import Access as Access
from rce.errors import InternalError, StartFailed
from rce.ready import Ready

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

DEV_USER = "testUser"
LOCAL = "http://127.0.0.1:9000/"
LOG_LINES = 20
ENGINES = ("process", "docker", "swarm")


def add_command(commands: Commands, name: str, text: str) -> argparse.ArgumentParser:
    """A subcommand; `text` stands in the list of commands, and as a sentence in its own help."""
    return commands.add_parser(name, help=text, description=f"{text[:1].upper()}{text[1:]}.")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("platform", "without --url, one is started for this command alone")
    group.add_argument("--url", default="", help="entry of a running platform, http://host:9000/")
    add_credentials(group)
    group.add_argument("--engine", choices=ENGINES, default="process", help="of the started platform")


def add_entry(group: argparse._ActionsContainer) -> None:
    """For commands that need a platform that runs."""
    group.add_argument("--url", default="", help=f"its entry (default: where you are signed in, else {LOCAL})")
    add_credentials(group)


def add_credentials(group: argparse._ActionsContainer) -> None:
    group.add_argument("--user", default=DEV_USER, help="(default: %(default)s)")
    group.add_argument("--password", default=None, help="better: RCE_PASSWORD or RCE_KEY in the environment")


def access(words: argparse.Namespace) -> Access:
    """The running platform of `--url`; else, if no credentials are given either, the one that the user is signed in to,
    or one of development on this machine.
    """
    password = words.password or os.environ.get("RCE_PASSWORD")
    key = None if password else os.environ.get("RCE_KEY")
    if password is None and key is None and words.user == DEV_USER:
        if not words.url and contexts.load().current:
            return contexts.access()
        password = DEV_USER  # the user of development platforms
    return Access(words.url or LOCAL, words.user, password, key)


@contextlib.asynccontextmanager
async def platform(words: argparse.Namespace) -> AsyncIterator[Access]:
    """The running platform of `--url`, or a fresh one that ends with the context."""
    if words.url:
        yield access(words)
        return
    with tempfile.TemporaryDirectory(prefix="rce-") as directory:
        async with own_platform(Path(directory), words.engine) as entry:
            yield Access(entry.url, DEV_USER, DEV_USER, None)


@contextlib.asynccontextmanager
async def own_platform(directory: Path, engine: str) -> AsyncIterator[Ready]:
    """A fresh platform that keeps what it has in `directory` and ends with the context."""
    with programs_log() as log:
        settings = up.Settings(data_dir=directory, http_port=0, dev=True, engine=engine)  # type: ignore[arg-type]
        entry: asyncio.Future[Ready] = asyncio.get_running_loop().create_future()

        async def started(ready: Ready) -> None:
            entry.set_result(ready)
            await asyncio.Event().wait()

        running = asyncio.create_task(up.run(settings, started, log))
        try:
            await asyncio.wait([running, entry], return_when=asyncio.FIRST_COMPLETED)  # type: ignore[type-var]
            if not entry.done():
                await running  # raises why it did not start
            yield entry.result()
        finally:
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running


@contextlib.contextmanager
def programs_log() -> Iterator[IO[str]]:
    """For what started programs log; shows its end when they go wrong."""
    with tempfile.TemporaryFile("w+") as log:
        try:
            yield log
        except (StartFailed, InternalError) as error:
            log.seek(0)
            sys.stderr.writelines(deque(log, LOG_LINES))
            raise error from None

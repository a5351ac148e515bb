"""Environment endpoint that is started before its environment is known: `python -P -m endpoints.environment.prepared`.

Loading Python, ROS 2 and the endpoint, and joining a ROS domain, take most of the time that an environment needs to
start. This program does that at once, then waits for its environment: a line of JSON on standard input. It ends if
standard input does. No user has used the process before. Beside it waits an interpreter for the first node
(`prepared_node`).
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
from collections.abc import Coroutine, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec import Struct
from twisted.internet.base import ReactorBase

from endpoints.environment import __main__ as program
from endpoints.environment import prepared_node, process_environment
from endpoints.environment.lazy_import import import_lazily
from endpoints.environment.settings import SEGMENT, Settings
from rce.process import loop, malloc
from rce.process.settings import load_or_exit

if TYPE_CHECKING:
    from endpoints.environment.ros import Ros


class Order(Struct, frozen=True):
    """Environment that the process shall serve: its variables, working directory, and the file for its output."""

    variables: dict[str, str]
    directory: str
    output: str


def load(typesupport: str) -> None:
    """Load what an endpoint needs; `typesupport` is its setting of this name."""
    prefixes = [Path(each) for each in typesupport.split(",") if each]
    sys.path += [str(prefix / "python") for prefix in prefixes]
    malloc.keep_large_blocks()
    import_lazily("numpy")
    import endpoints.environment.endpoint
    import endpoints.environment.ros  # noqa: F401


def accept(order: Order) -> Settings:
    """Become the endpoint of an environment: take its variables, directory and output, and return its settings."""
    os.environ.update(order.variables)
    os.chdir(order.directory)
    output = os.open(order.output, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
    for stream in (1, 2):
        os.dup2(output, stream)
    os.close(output)
    settings = load_or_exit(Settings, "rce environment", [])
    os.environ.pop("RCE_TOKEN", None)
    process_environment.prepare(settings)
    return settings


def join_domain(profile: Path) -> Ros:
    """Return a ROS node that has joined the domain of this process, on a machine without network groups.

    Args:
        profile: File for the profile of Fast DDS.
    """
    from endpoints.environment.ros import Ros

    process_environment.use_profile(profile, SEGMENT)
    return Ros()


@contextmanager
def profile_file() -> Iterator[Path]:
    """Provide an empty file, which is removed at the end, if not before."""
    descriptor, name = tempfile.mkstemp("-fastdds.xml", "rce-")
    os.close(descriptor)
    try:
        yield Path(name)
    finally:
        Path(name).unlink(missing_ok=True)


async def serve(reactor: ReactorBase) -> None:
    """Wait for the order, then serve the environment until its end."""
    with profile_file() as profile:
        ros = join_domain(profile)
        spare = await prepared_node.start()  # it removes the profile when it has joined the domain with it
        try:
            line = await asyncio.to_thread(sys.stdin.buffer.readline)
            if not line:
                ros.close()
                return
            settings = accept(msgspec.json.decode(line, type=Order))
            fits = settings.shared_memory == SEGMENT and not settings.address
            if not fits:  # it has to join again with another profile
                ros.close()
            await program.Endpoint(settings, spare, ros if fits else None).run(reactor)
        finally:
            await spare.discard()


def main() -> int:
    """Run the program; return its exit status."""
    load(os.environ.get("RCE_TYPESUPPORT", ""))

    def run(reactor: ReactorBase) -> Coroutine[None, None, None]:
        return serve(reactor)

    return loop.run(run)


if __name__ == "__main__":
    sys.exit(main())

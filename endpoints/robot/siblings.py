"""Further processes of a Robot endpoint, which serve robots at the same port: one process uses one core.

Each is a Robot endpoint of its own to the Master, and the kernel divides the connections among them. The first process
starts the others and restarts those that end.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import IO

from twisted.logger import Logger

from rce.api.joining import sibling_name
from rce.control.calls.joining import InviteSibling, JoinToken
from rce.errors import RceError
from rce.process.supervisor import ManagedProcess

PAUSE = 1.0  # seconds until a start that failed is tried again

log = Logger()
Invite = Callable[[InviteSibling], Awaitable[JoinToken]]


def sibling_arguments(
    given: Sequence[str], name: str, data_dir: Path, ws_port: int, data_port: int, number: int
) -> list[str]:
    """Return the command line of a further process: that of the first one, with what differs after it.

    Args:
        given: Command line of the first process.
        name: Name of the first process.
        data_dir: Directory of the first process.
        ws_port: Port at which the first process serves robots.
        data_port: Setting of the first process: port for data links, or 0 for any free one.
        number: Number of the further process.
    """
    return [
        *given,
        f"--name={sibling_name(name, number)}",
        f"--data-dir={data_dir / str(number)}",
        f"--ws-port={ws_port}",
        f"--data-port={data_port + number - 1 if data_port else 0}",
        "--processes=1",
        "--share-port",
    ]


class Siblings:
    """The further processes of this Robot endpoint."""

    def __init__(self, count: int, data_dir: Path, arguments: Callable[[int], list[str]], log: IO[str]) -> None:
        """Describe the processes, which `run` starts.

        Args:
            count: Number of all processes, this one included.
            data_dir: Directory of this process; each further one has a directory in it.
            arguments: Makes the command line of the process of a number.
            log: File for the logs of the processes.
        """
        self._numbers = range(2, count + 1)
        self._data_dir = data_dir
        self._arguments = arguments
        self._log = log

    async def run(self, invite: Invite) -> None:
        """Start the processes, keep them running until cancelled, and stop them.

        Args:
            invite: Asks the Master for the join token of a process that has no credential yet.
        """
        async with asyncio.TaskGroup() as group:
            for number in self._numbers:
                group.create_task(self._keep(number, invite))

    async def _keep(self, number: int, invite: Invite) -> None:
        while True:
            process: ManagedProcess | None = None
            try:
                has_credential = (self._data_dir / str(number) / "credential").exists()
                token = "" if has_credential else (await invite(InviteSibling(number))).token
                process = ManagedProcess("robot", lambda: self._arguments(number), {"RCE_TOKEN": token}, self._log)
                await process.start()
                await asyncio.Event().wait()
            except RceError as error:
                log.warn("process {number} of this endpoint: {error}", number=number, error=str(error))
                await asyncio.sleep(PAUSE)
            finally:
                if process is not None:
                    await process.stop()

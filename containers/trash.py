"""Removal of files and directories with any contents, without making anyone wait for it."""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path

from twisted.logger import Logger

log = Logger()
WAIT = 5.0  # seconds for which `discard` waits; most trees are gone in milliseconds


class Trash:
    """Removes trees in the background, one after another.

    A tree may have been written by a user's program: with millions of files, or deeper than any path is long. So it is
    first moved to `directory`, which takes its name away at once, and then removed by `rm`, a process of its own that
    does not recurse. What cannot be removed is logged, and tried again by the next `open`.

    `directory` must be on the file system of what is discarded.
    """

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._lock = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    def open(self) -> None:
        """Create the directory, and begin to remove what an earlier process left in it.

        Raises:
            OSError: The directory cannot be created.
        """
        self._directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        for path in self._directory.iterdir():
            self._remove_in_background(path)

    async def discard(self, path: Path) -> None:
        """Remove a file or a tree if it exists; wait for at most WAIT until its space is free. Never fails."""
        if removal := self.take(path):
            await asyncio.wait([removal], timeout=WAIT)

    def take(self, path: Path) -> asyncio.Task[None] | None:
        """Take a file or a tree away from its path at once; return the removal, which runs in the background.

        Returns:
            None if there is nothing at `path`, or it cannot be moved, which is logged.
        """
        target = self._directory / secrets.token_hex(8)
        try:
            path.rename(target)
        except FileNotFoundError:
            return None
        except OSError as error:
            log.error("{path} cannot be removed: {error}", path=str(path), error=str(error))
            return None
        return self._remove_in_background(target)

    async def close(self) -> None:
        """Interrupt removals; the next process continues them."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _remove_in_background(self, path: Path) -> asyncio.Task[None]:
        task = asyncio.create_task(self._remove(path))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def _remove(self, path: Path) -> None:
        async with self._lock:
            try:
                process = await asyncio.create_subprocess_exec(
                    *("rm", "-rf", "--one-file-system", "--", str(path)),
                    stdin=asyncio.subprocess.DEVNULL,
                    stdout=asyncio.subprocess.DEVNULL,
                    stderr=asyncio.subprocess.PIPE,
                )
            except OSError as error:
                log.error("{path} cannot be removed: {error}", path=str(path), error=str(error))
                return
            try:
                _, errors = await process.communicate()
            except asyncio.CancelledError:
                process.kill()
                await process.wait()
                raise
        if process.returncode:
            reason = errors.decode(errors="replace").partition("\n")[0]
            log.error("{path} was not removed completely: {reason}", path=str(path), reason=reason)

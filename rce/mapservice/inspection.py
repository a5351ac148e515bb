"""Inspection of recordings before a job is accepted."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, LimitExceeded
from rce.mapservice.job_program import Task
from rce.mapservice.uploads import Uploads

MAX_INSPECTIONS, MAX_INSPECTIONS_OF_USER = 4, 2  # at the same time


def collect(uploads: Uploads, user: str, names: Iterable[str], directory: Path) -> Path:
    """Link a user's uploads into a new directory.

    Returns:
        The path of the recording, see `recording_in`.

    Raises:
        NotFound: The user has no such upload.
        InvalidRequest: An upload is incomplete, or two have the same file name.
    """
    directory.mkdir(mode=0o700)
    for index, name in enumerate(names):
        field = f"uploads[{index}]"
        upload = uploads.get(user, name, field)
        if upload.offset < upload.length:
            text = f"{upload.name} is not complete: {upload.offset} of {upload.length} bytes are there"
            raise InvalidRequest(text, field=field)
        try:
            os.link(uploads.path(name), directory / upload.name)
        except FileExistsError:
            raise InvalidRequest(f"there are two files {upload.name}", field=field) from None
        uploads.touch(name)
    return recording_in(directory)


def recording_in(directory: Path) -> Path:
    """Return the recording in a directory: its only file, or the directory itself if there are several files."""
    files = list(directory.iterdir())
    return files[0] if len(files) == 1 else directory


class Inspector(Protocol):
    """Inspects recordings; see `rce.mapservice.job_runner`."""

    async def inspect(self, task: Task) -> int | None:
        """Return the number of scans of a recording, None if it is unknown; raise RceError if it cannot be mapped."""


class InspectionQueue:
    """Limits the number of simultaneous inspections, in all and of one user; each is a process with its own memory."""

    def __init__(self, inspector: Inspector) -> None:
        self._inspector = inspector
        self._of_user: Counter[str] = Counter()
        self._slots = asyncio.Semaphore(MAX_INSPECTIONS)

    def count(self, user: str) -> int:
        """Return the number of running and waiting inspections of a user."""
        return self._of_user[user]

    async def inspect(self, user: str, task: Task) -> int | None:
        """Inspect a recording and return the number of its scans, None if it is unknown.

        Raises:
            LimitExceeded: The user has too many inspections already.
            RceError: The recording cannot be mapped.
        """
        if self._of_user[user] >= MAX_INSPECTIONS_OF_USER:
            text = f"{MAX_INSPECTIONS_OF_USER} of your recordings are being inspected: wait until one is done"
            raise LimitExceeded(text, limit=MAX_INSPECTIONS_OF_USER)
        self._of_user[user] += 1
        try:
            async with self._slots:
                return await self._inspector.inspect(task)
        finally:
            self._of_user[user] -= 1

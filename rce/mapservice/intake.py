"""What a job is to map: its uploads in one directory, looked at before there is a job."""

from __future__ import annotations

import asyncio
import os
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from rce.errors import InvalidRequest, LimitExceeded
from rce.mapservice.uploads import Uploads
from rce.mapservice.work import Task

LOOKS, LOOKS_OF_USER = 4, 2  # recordings that are looked at, at once


def collect(uploads: Uploads, user: str, names: Iterable[str], place: Path) -> Path:
    """Link a user's uploads into a new directory: where the recording is. InvalidRequest, NotFound."""
    place.mkdir(mode=0o700)
    for index, name in enumerate(names):
        field = f"uploads[{index}]"
        upload = uploads.get(user, name, field)
        if upload.offset < upload.length:
            text = f"{upload.name} is not complete: {upload.offset} of {upload.length} bytes are there"
            raise InvalidRequest(text, field=field)
        try:
            os.link(uploads.path(name), place / upload.name)
        except FileExistsError:
            raise InvalidRequest(f"there are two files {upload.name}", field=field) from None
        uploads.touch(name)
    return collected(place)


def collected(place: Path) -> Path:
    """The recording that was collected there: its one file, or the directory with all of them."""
    files = list(place.iterdir())
    return files[0] if len(files) == 1 else place


class Looker(Protocol):
    """Who can tell whether a recording can be mapped; see `rce.mapservice.worker`."""

    async def look(self, task: Task) -> int | None: ...


class Intake:
    """Looks at recordings. Each look is a process with memory of its own: a few at once, and fewer of one user."""

    def __init__(self, looker: Looker) -> None:
        self._looker = looker
        self._of: Counter[str] = Counter()  # by user
        self._gate = asyncio.Semaphore(LOOKS)

    def count(self, user: str) -> int:
        """Recordings of this user that are being looked at, or wait for it."""
        return self._of[user]

    async def look(self, user: str, task: Task) -> int | None:
        """How many scans the recording has, if it says so. Raises RceError if it cannot be mapped; LimitExceeded."""
        if self._of[user] >= LOOKS_OF_USER:
            text = f"{LOOKS_OF_USER} recordings of yours are being looked at: wait for an answer"
            raise LimitExceeded(text, limit=LOOKS_OF_USER)
        self._of[user] += 1
        try:
            async with self._gate:
                return await self._looker.look(task)
        finally:
            self._of[user] -= 1

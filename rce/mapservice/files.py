"""Records in files: each upload and each job is a directory with its record, so removing that removes all of it.

A record is replaced as a whole, so it survives the death of the process. What a power cut takes is seen by the size of
a file: an upload that has become shorter is resumed.
"""

from __future__ import annotations

import errno
import re
import secrets
import shutil
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from twisted.logger import Logger

from rce.errors import InvalidRequest, Unavailable

T = TypeVar("T", bound=msgspec.Struct)
RECORD = "record.json"
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")

log = Logger()


class DiskFull(Unavailable):
    """There is no room on the disk of the map service, though there was when the upload or the job was announced."""

    @classmethod
    def of(cls, error: BaseException) -> DiskFull | None:
        """What a client is told of this error, if that is what it means."""
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return cls("the disk of the map service is full: what has come is kept, so go on when there is room again")
        return None


def new_id() -> str:
    return secrets.token_hex(12)


def check_file_name(name: str, field: str) -> str:
    """The name, if it is safe as that of a file. InvalidRequest."""
    if not FILE_NAME.fullmatch(name) or name == RECORD:
        raise InvalidRequest(
            f"{name[:60]!r} is no file name: letters, digits, '.', '_' and '-' are allowed, 200 at most", field=field
        )
    return name


class Shelf(Generic[T]):
    """Directories with records of one type, by id."""

    def __init__(self, directory: Path, kind: type[T]) -> None:
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.directory = directory
        self._kind = kind

    def place(self, name: str) -> Path:
        return self.directory / name

    def put(self, name: str, record: T) -> None:
        place = self.place(name)
        place.mkdir(exist_ok=True, mode=0o700)
        draft = place / f".{RECORD}"
        draft.write_bytes(msgspec.json.encode(record))
        draft.rename(place / RECORD)

    def load(self) -> dict[str, T]:
        """All records. What has none was never acknowledged, or was being removed: it goes; a damaged one is logged."""
        found = {}
        for place in sorted(self.directory.iterdir()):
            if not (place / RECORD).exists():
                shutil.rmtree(place, ignore_errors=True)
                continue
            try:
                found[place.name] = msgspec.json.decode((place / RECORD).read_bytes(), type=self._kind)
            except (OSError, msgspec.DecodeError) as error:
                log.warn("{place} is not used: {error}", place=str(place), error=str(error))
        return found

"""Records in files: each upload, job or recording is a directory with its record, and is removed with it.

A record is replaced atomically, so it survives the death of the process. A power failure may truncate an upload, which
its file size shows; the client then resumes it.
"""

from __future__ import annotations

import re
import secrets
import shutil
from pathlib import Path
from typing import Generic, TypeVar

import msgspec
from twisted.logger import Logger

from rce.errors import InvalidRequest

T = TypeVar("T", bound=msgspec.Struct)
RECORD = "record.json"
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,199}")

log = Logger()


def new_id() -> str:
    """Return a random id."""
    return secrets.token_hex(12)


def check_file_name(name: str, field: str) -> str:
    """Check that a name is safe as a file name, and return it.

    Raises:
        InvalidRequest: The name is not safe; the error names `field`.
    """
    if not FILE_NAME.fullmatch(name) or name == RECORD:
        raise InvalidRequest(
            f"{name[:60]!r} is not a valid file name: at most 200 letters, digits, '.', '_' and '-'", field=field
        )
    return name


class RecordStore(Generic[T]):
    """Directories with records of one type, by id."""

    def __init__(self, directory: Path, kind: type[T]) -> None:
        """Create the directory if it is missing."""
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.directory = directory
        self._kind = kind

    def path(self, name: str) -> Path:
        """Return the directory of a record."""
        return self.directory / name

    def put(self, name: str, record: T) -> None:
        """Write a record; create its directory if it is missing."""
        path = self.path(name)
        path.mkdir(exist_ok=True, mode=0o700)
        draft = path / f".{RECORD}"
        draft.write_bytes(msgspec.json.encode(record))
        draft.rename(path / RECORD)

    def load(self) -> dict[str, T]:
        """Load all records.

        A directory without a record was never acknowledged, or was being removed: it is removed. Malformed records are
        logged.
        """
        found = {}
        for path in sorted(self.directory.iterdir()):
            if not (path / RECORD).exists():
                shutil.rmtree(path, ignore_errors=True)
                continue
            try:
                found[path.name] = msgspec.json.decode((path / RECORD).read_bytes(), type=self._kind)
            except (OSError, msgspec.DecodeError, UnicodeDecodeError) as error:
                log.warn("ignoring {path}: {error}", path=str(path), error=str(error))
        return found

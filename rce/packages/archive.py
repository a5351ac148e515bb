"""Archive format of users' ROS packages; an archive is identified by the SHA-256 of its bytes.

An archive is a canonical tar file, exactly one for each content: regular files only, sorted by name, with USTAR headers
that have neither times nor owners. So pushing a directory twice gives the same digest, and the known dangers of
untrusted tar files (links, devices, paths outside of the target, extended headers, duplicates) cannot be expressed.
Directories are implied by the paths of the files.
"""

from __future__ import annotations

import hashlib
import os
import re
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from msgspec import Struct

from rce.errors import InvalidRequest, LimitExceeded

DIGEST = re.compile(r"[0-9a-f]{64}", re.ASCII)
MAX_BYTES = 4 * 1024**3
MAX_FILES = 20_000
BLOCK = 512
CHUNK = 256 * 1024
EXECUTABLE, PLAIN = 0o755, 0o644
_PART = re.compile(r"[A-Za-z0-9_@+=.,~()\[\]{} -]+", re.ASCII)


class Entry(NamedTuple):
    """File of an archive: `path` is its name in the archive, with `/`; `source` has its content."""

    path: str
    source: Path
    executable: bool


class Contents(Struct, frozen=True):
    """Summary of an archive: its size in bytes, the number of its files, and the ROS packages in it.

    An `installed` archive is a ROS 2 install prefix (`share/PKG`, `lib/PKG`); otherwise it has sources (`PKG/…`).
    """

    digest: str
    size: int
    files: int
    packages: list[str]
    installed: bool


def write(entries: Iterable[Entry], file: BinaryIO) -> None:
    """Write an archive.

    Raises:
        InvalidRequest: A path cannot be represented in an archive, or a file changed while it was read.
    """
    for entry in sorted(entries, key=lambda entry: entry.path.encode()):
        header = tarfile.TarInfo(entry.path)
        header.mode = EXECUTABLE if entry.executable else PLAIN
        with entry.source.open("rb") as source:
            header.size = os.fstat(source.fileno()).st_size
            _check_path(entry.path)
            file.write(_header(header))
            copied = sum(file.write(chunk) for chunk in iter(lambda: source.read(CHUNK), b""))
        if copied != header.size:
            raise InvalidRequest(f"{entry.source} changed while it was being read: try again")
        file.write(bytes(-copied % BLOCK))
    file.write(bytes(2 * BLOCK))


def inspect(file: BinaryIO) -> Contents:
    """Read an archive completely and validate it.

    Raises:
        InvalidRequest: It is not a valid archive or contains no ROS package.
        LimitExceeded: It has too many files.
    """
    paths: list[str] = []
    hashing = _Hashing(file)
    for header in _headers(hashing):
        paths.append(header.name)
        hashing.skip(header.size)
    _check_tree(paths)
    packages, installed = _packages(paths)
    if not packages:
        raise InvalidRequest("the archive contains no ROS package: neither PKG/package.xml nor share/PKG/package.xml")
    return Contents(hashing.digest, hashing.size, len(paths), packages, installed)


def unpack(file: BinaryIO, directory: Path) -> Contents:
    """Validate an archive as `inspect` does and unpack it into the empty `directory`, read-only for all users."""
    contents = inspect(file)
    file.seek(0)
    for header in _headers(file):
        target = directory / header.name
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as out:
            left = header.size
            while left:
                left -= out.write(_exactly(file, min(left, CHUNK)))
        _exactly(file, -header.size % BLOCK)
        target.chmod(0o555 if header.mode & 0o100 else 0o444)
    for path in (directory, *(path for path in directory.rglob("*") if path.is_dir())):
        path.chmod(0o555)
    return contents


class _Hashing:
    """Reader that hashes what it reads."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._hash = hashlib.sha256()
        self.size = 0

    def read(self, count: int) -> bytes:
        data = self._file.read(count)
        self._hash.update(data)
        self.size += len(data)
        return data

    def skip(self, count: int) -> None:
        """Skip the content of a file with the padding of its last block."""
        left = count + -count % BLOCK
        while left:
            left -= len(_exactly(self, min(left, CHUNK)))

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


def _headers(file: BinaryIO | _Hashing) -> Iterator[tarfile.TarInfo]:
    """Yield the headers and check that the archive ends after the last; the caller reads the content after each."""
    previous = b""
    count = 0
    while (block := _exactly(file, BLOCK)) != bytes(BLOCK):
        header = _parse(block)
        if header.name.encode() <= previous:
            raise InvalidRequest(f"archive: {header.name[:200]!r} is a duplicate or out of order")
        count += 1
        if count > MAX_FILES:
            raise LimitExceeded(f"the archive has more than {MAX_FILES} files", limit=MAX_FILES)
        yield header
        previous = header.name.encode()
    if _exactly(file, BLOCK) != bytes(BLOCK) or file.read(1):
        raise InvalidRequest("archive: there is data after the end marker")


def _parse(block: bytes) -> tarfile.TarInfo:
    try:
        header = tarfile.TarInfo.frombuf(block, "ascii", "strict")
    except (tarfile.HeaderError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"archive: malformed header ({error}); create archives with `rce package push`") from None
    if header.type != tarfile.REGTYPE:
        raise InvalidRequest(f"archive: {header.name[:200]!r} is not a regular file; links and devices are not allowed")
    _check_path(header.name)
    if header.mode not in (EXECUTABLE, PLAIN) or not 0 <= header.size <= MAX_BYTES or block != _header(header):
        raise InvalidRequest(f"archive: the header of {header.name[:200]!r} has fields other than name, size and mode")
    return header


def _header(header: tarfile.TarInfo) -> bytes:
    plain = tarfile.TarInfo(header.name)
    plain.size, plain.mode = header.size, header.mode
    try:
        return plain.tobuf(tarfile.USTAR_FORMAT, "ascii", "strict")
    except ValueError as error:  # includes UnicodeEncodeError
        raise InvalidRequest(f"path {header.name[:200]!r} cannot be stored in an archive: {error}") from None


def _check_path(path: str) -> None:
    for part in path.split("/"):
        if not _PART.fullmatch(part) or part in (".", ".."):
            raise InvalidRequest(
                f"path {path[:200]!r} is not allowed: it must be relative, without . and .., in plain characters"
            )


def _check_tree(paths: list[str]) -> None:
    files = set(paths)
    for path in paths:
        parents = path.split("/")[:-1]
        if any("/".join(parents[:depth]) in files for depth in range(1, len(parents) + 1)):
            raise InvalidRequest(f"archive: a parent directory of {path[:200]!r} is a file")


def _packages(paths: list[str]) -> tuple[list[str], bool]:
    described = [path.split("/")[:-1] for path in paths if path.endswith("/package.xml")]
    installed = any(path.startswith("share/") for path in paths)
    if installed:
        return sorted(parts[1] for parts in described if len(parts) == 2 and parts[0] == "share"), True
    return sorted(parts[0] for parts in described if len(parts) == 1), False


def _exactly(file: BinaryIO | _Hashing, count: int) -> bytes:
    data = file.read(count)
    if len(data) != count:
        raise InvalidRequest("archive: the file is truncated")
    return data

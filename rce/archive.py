"""A user's ROS packages as one archive, and the archive's name: the SHA-256 of its bytes.

The archive is a tar of its own kind, of which there is one for each content: regular files only, ascending by name,
USTAR headers without times and owners. So a directory pushed twice has one digest, and what a reader must beware of in
tars of strangers (links, devices, paths that lead out, extensions that redefine earlier headers, one name twice) has no
place in it. Directories are those of the files.
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
    """A file of an archive: `path` as it will be unpacked, with `/`."""

    path: str
    source: Path
    executable: bool


class Contents(Struct, frozen=True):
    """What an archive holds: `packages` are those with a `package.xml`, `size` is that of the archive in bytes.

    An `installed` archive is a prefix of ROS 2 (`share/PKG`, `lib/PKG`); else its packages are sources (`PKG/…`).
    """

    digest: str
    size: int
    files: int
    packages: list[str]
    installed: bool


def write(entries: Iterable[Entry], file: BinaryIO) -> None:
    """Write an archive. InvalidRequest for a path that does not fit in one."""
    for entry in sorted(entries, key=lambda entry: entry.path.encode()):
        header = tarfile.TarInfo(entry.path)
        header.mode = EXECUTABLE if entry.executable else PLAIN
        with entry.source.open("rb") as source:
            header.size = os.fstat(source.fileno()).st_size
            _check_path(entry.path)
            file.write(_header(header))
            copied = sum(file.write(chunk) for chunk in iter(lambda: source.read(CHUNK), b""))
        if copied != header.size:
            raise InvalidRequest(f"{entry.source} changed while it was read: try again")
        file.write(bytes(-copied % BLOCK))
    file.write(bytes(2 * BLOCK))


def inspect(file: BinaryIO) -> Contents:
    """Read an archive through and check all of it. InvalidRequest, LimitExceeded."""
    paths: list[str] = []
    hashing = _Hashing(file)
    for header in _headers(hashing):
        paths.append(header.name)
        hashing.skip(header.size)
    _check_tree(paths)
    packages, installed = _packages(paths)
    if not packages:
        raise InvalidRequest("there is no ROS package in it: no PKG/package.xml and no share/PKG/package.xml")
    return Contents(hashing.digest, hashing.size, len(paths), packages, installed)


def unpack(file: BinaryIO, directory: Path) -> Contents:
    """`inspect`, and write the files under the empty `directory`, for everybody to read and nobody to change."""
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
    """Reads and hashes."""

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
        """The content of a file, with what fills its last block."""
        left = count + -count % BLOCK
        while left:
            left -= len(_exactly(self, min(left, CHUNK)))

    @property
    def digest(self) -> str:
        return self._hash.hexdigest()


def _headers(file: BinaryIO | _Hashing) -> Iterator[tarfile.TarInfo]:
    """The headers; the caller reads what follows each. At the end nothing is left of the file."""
    before = b""
    count = 0
    while (block := _exactly(file, BLOCK)) != bytes(BLOCK):
        header = _parse(block)
        if header.name.encode() <= before:
            raise InvalidRequest(f"archive: {header.name[:200]!r} is there twice or out of order")
        count += 1
        if count > MAX_FILES:
            raise LimitExceeded(f"an archive has {MAX_FILES} files at most", limit=MAX_FILES)
        yield header
        before = header.name.encode()
    if _exactly(file, BLOCK) != bytes(BLOCK) or file.read(1):
        raise InvalidRequest("archive: something stands behind its end")


def _parse(block: bytes) -> tarfile.TarInfo:
    try:
        header = tarfile.TarInfo.frombuf(block, "ascii", "strict")
    except (tarfile.HeaderError, UnicodeDecodeError) as error:
        raise InvalidRequest(f"archive: a header cannot be read ({error}); make it with `rce package push`") from None
    if header.type != tarfile.REGTYPE:
        raise InvalidRequest(f"archive: {header.name[:200]!r} is no regular file; links and devices are not taken")
    _check_path(header.name)
    if header.mode not in (EXECUTABLE, PLAIN) or not 0 <= header.size <= MAX_BYTES or block != _header(header):
        raise InvalidRequest(f"archive: the header of {header.name[:200]!r} says more than name, size and mode")
    return header


def _header(header: tarfile.TarInfo) -> bytes:
    plain = tarfile.TarInfo(header.name)
    plain.size, plain.mode = header.size, header.mode
    try:
        return plain.tobuf(tarfile.USTAR_FORMAT, "ascii", "strict")
    except ValueError as error:  # of which UnicodeEncodeError is one
        raise InvalidRequest(f"path {header.name[:200]!r} does not fit in an archive: {error}") from None


def _check_path(path: str) -> None:
    for part in path.split("/"):
        if not _PART.fullmatch(part) or part in (".", ".."):
            raise InvalidRequest(f"path {path[:200]!r} is not taken: it is absolute, leads out, or has odd characters")


def _check_tree(paths: list[str]) -> None:
    files = set(paths)
    for path in paths:
        parents = path.split("/")[:-1]
        if any("/".join(parents[:depth]) in files for depth in range(1, len(parents) + 1)):
            raise InvalidRequest(f"archive: {path[:200]!r} lies in what is a file")


def _packages(paths: list[str]) -> tuple[list[str], bool]:
    described = [path.split("/")[:-1] for path in paths if path.endswith("/package.xml")]
    installed = any(path.startswith("share/") for path in paths)
    if installed:
        return sorted(parts[1] for parts in described if len(parts) == 2 and parts[0] == "share"), True
    return sorted(parts[0] for parts in described if len(parts) == 1), False


def _exactly(file: BinaryIO | _Hashing, count: int) -> bytes:
    data = file.read(count)
    if len(data) != count:
        raise InvalidRequest("archive: it is cut off")
    return data

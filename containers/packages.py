"""Cache of users' packages on this machine, fetched from the Master when an environment first needs one.

`DIGEST/` holds an unpacked archive and is read-only. `uses/RUN` lists the digests that the environment of that run
uses, so that the next task set knows which packages are in use.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import tempfile
from collections.abc import Awaitable, Callable, Collection, Mapping
from pathlib import Path
from weakref import WeakValueDictionary

from twisted.logger import Logger

from containers.engine import RUN
from rce.errors import InvalidRequest, StartFailed, Unavailable, disk_full
from rce.packages import archive

log = Logger()
KEPT = 4 * 1024**3  # bytes of unused packages that are kept
Fetch = Callable[[str, Path], Awaitable[None]]


def package_directories(root: Path, digests: Collection[str]) -> list[str]:
    """Return the directories of packages; they exist once `PackageCache.provide` has returned.

    Raises:
        InvalidRequest: A digest is malformed.
    """
    for digest in digests:
        if not archive.DIGEST.fullmatch(digest):
            raise InvalidRequest(f"package {digest[:80]!r} is not the digest of a package")
    return [str(root / digest) for digest in digests]


def package_path(directories: Collection[str], settings: Mapping[str, str]) -> dict[str, str]:
    """Return the endpoint's setting `package_path`, with an environment's own packages before those of the machine."""
    return {"package_path": ",".join([*directories, *filter(None, [settings.get("package_path")])])}


class PackageCache:
    """Packages in `root`; `fetch` writes the archive of a digest into a file.

    Unused packages of up to `kept` bytes remain cached.
    """

    def __init__(self, root: Path, fetch: Fetch, kept: int = KEPT) -> None:
        self._root = root
        self._uses = root / "uses"
        self._incoming = root / "incoming"
        self._fetch = fetch
        self._kept = kept
        self._sizes: dict[str, int] = {}
        self._shrinking = asyncio.Lock()
        self._locks: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    def open(self) -> None:
        """Create the directories and remove incomplete downloads of an earlier task set."""
        for directory in (self._root, self._uses, self._incoming):
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        for path in self._incoming.iterdir():
            _remove(path)

    async def provide(self, run: str, digests: Collection[str]) -> None:
        """Fetch missing packages and mark all as used by a run until `release`.

        Raises:
            NotFound: The Master has no such package.
            StartFailed: A package cannot be fetched or stored.
        """
        package_directories(self._root, digests)
        if not RUN.fullmatch(run):
            raise InvalidRequest(f"run {run[:80]!r} is not 32 hex digits", field="run")
        if not digests:
            return
        try:
            (self._uses / run).write_text("\n".join(digests))  # first, so that `release` removes none of them meanwhile
            for digest in digests:
                await self._provide(digest)
        except OSError as error:
            raise StartFailed(f"packages could not be stored: {disk_full(error) or error}") from None
        except Unavailable as error:
            raise StartFailed(f"packages could not be fetched: {error}") from None

    async def release(self, running: Collection[str]) -> None:
        """Mark packages as unused that no run in `running` uses; remove unused packages beyond the size limit."""
        for path in self._uses.iterdir():
            if path.name not in running:
                path.unlink(missing_ok=True)
        async with self._shrinking:
            await self._shrink()

    async def _provide(self, digest: str) -> None:
        lock = self._locks.get(digest)
        if lock is None:
            lock = self._locks[digest] = asyncio.Lock()
        async with lock:
            target = self._root / digest
            if target.is_dir():
                os.utime(target)  # `_shrink` removes the least recently used first
                return
            work = Path(tempfile.mkdtemp(dir=self._incoming))
            try:
                await self._fetch(digest, work / "archive")
                await asyncio.to_thread(_unpack, work / "archive", work / "tree", digest)
                (work / "tree").chmod(0o755)  # rename needs write permission on the directory itself
                (work / "tree").rename(target)
                target.chmod(0o555)
            finally:
                await asyncio.to_thread(_remove, work)
            log.info("fetched package {digest}", digest=digest)

    def _used(self) -> set[str]:
        return {digest for path in self._uses.iterdir() for digest in path.read_text().split()}

    async def _shrink(self) -> None:
        """Remove the least recently used packages until the unused ones fit the size limit."""
        used = self._used()
        idle = [path for path in self._root.iterdir() if archive.DIGEST.fullmatch(path.name) and path.name not in used]
        idle.sort(key=lambda path: path.stat().st_mtime, reverse=True)
        total = 0
        for path in idle:
            if path.name not in self._sizes:
                self._sizes[path.name] = await asyncio.to_thread(_size, path)
            total += self._sizes[path.name]
            # It may have been provided again meanwhile; from here to the renaming nothing else runs.
            if total > self._kept and path.name not in self._locks and path.name not in self._used():
                doomed = path.rename(self._incoming / path.name)
                del self._sizes[path.name]
                await asyncio.to_thread(_remove, doomed)
                log.info("removed unused package {digest}", digest=path.name)


def _unpack(path: Path, directory: Path, digest: str) -> None:
    directory.mkdir()
    with path.open("rb") as file:
        contents = archive.unpack(file, directory)
    if contents.digest != digest:
        raise StartFailed(f"the Master sent another package than {digest}: its digest is {contents.digest}")


def _size(directory: Path) -> int:
    return sum(path.lstat().st_size for path in directory.rglob("*"))


def _remove(path: Path) -> None:
    """Remove a file or a directory tree, even if it is read-only."""
    if path.is_dir():
        for each in (path, *path.rglob("*")):
            if each.is_dir():
                with contextlib.suppress(FileNotFoundError):
                    each.chmod(0o700)
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)

"""Package cache of a machine: packages are fetched once and atomically, and kept while they are used."""

from __future__ import annotations

import asyncio
import errno
import hashlib
import io
import os
import threading
from pathlib import Path

import pytest

from containers import packages
from containers.packages import PackageCache, package_directories, package_path
from rce.errors import InvalidRequest, NotFound, RceError, StartFailed, Unavailable
from rce.packages import archive

RUN, OTHER = "a" * 32, "b" * 32


class Master:
    """Serves archives, and counts how often they are fetched."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.archives: dict[str, bytes] = {}
        self.fetched: list[str] = []
        self.refuse: Exception | None = None
        self.go = asyncio.Event()
        self.go.set()

    def add(self, content: bytes) -> str:
        source = self.directory / "source"
        source.write_bytes(content)
        out = io.BytesIO()
        archive.write([archive.Entry("p/package.xml", source, False), archive.Entry("p/talk", source, True)], out)
        digest = hashlib.sha256(out.getvalue()).hexdigest()
        self.archives[digest] = out.getvalue()
        return digest

    async def fetch(self, digest: str, path: Path) -> None:
        self.fetched.append(digest)
        await self.go.wait()
        if self.refuse is not None:
            raise self.refuse
        await asyncio.to_thread(path.write_bytes, self.archives[digest])


@pytest.fixture
def master(tmp_path: Path) -> Master:
    return Master(tmp_path)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return tmp_path / "packages"


@pytest.fixture
def cache(root: Path, master: Master) -> PackageCache:
    cache = PackageCache(root, master.fetch, kept=0)
    cache.open()
    return cache


def present(root: Path) -> set[str]:
    assert list((root / "incoming").iterdir()) == []
    return {path.name for path in root.iterdir()} - {"uses", "incoming"}


async def test_package_is_fetched_once_and_read_only(cache: PackageCache, master: Master, root: Path) -> None:
    digest = master.add(b"content")
    master.go.clear()
    both = asyncio.gather(cache.provide(RUN, [digest]), cache.provide(OTHER, [digest]))
    await asyncio.sleep(0)
    assert not (root / digest).exists()  # it appears when it is complete
    master.go.set()
    await both
    assert master.fetched == [digest]
    assert (root / digest / "p/talk").read_bytes() == b"content"
    modes = [(root / digest / name).stat().st_mode & 0o777 for name in ("", "p", "p/talk", "p/package.xml")]
    assert modes == [0o555, 0o555, 0o555, 0o444]
    assert present(root) == {digest}


async def test_package_is_kept_while_used(cache: PackageCache, master: Master, root: Path) -> None:
    one, two = master.add(b"one"), master.add(b"two")
    await cache.provide(RUN, [one, two])
    await cache.provide(OTHER, [one])
    await cache.release([RUN, OTHER])
    assert present(root) == {one, two}
    await cache.release([OTHER])
    assert present(root) == {one}
    again = PackageCache(root, master.fetch, kept=0)  # that of the next task set
    again.open()
    await again.release([OTHER])
    assert present(root) == {one}
    await again.release([])
    assert present(root) == set()
    await again.provide(RUN, [one])
    assert master.fetched == [one, two, one]


async def test_least_recently_used_package_is_removed_first(master: Master, root: Path) -> None:
    cache = PackageCache(root, master.fetch, kept=35_000)
    cache.open()
    digests = [master.add(bytes([number]) * 5_000) for number in range(3)]  # each 10 kB unpacked, and directories
    for at, digest in enumerate(digests):
        await cache.provide(RUN, [digest])
        os.utime(root / digest, (at, at))
    await cache.provide(RUN, digests[:1])
    await cache.release([])
    assert present(root) == {digests[0], digests[2]}


async def test_package_that_is_provided_while_space_is_made_stays(
    cache: PackageCache, master: Master, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    digest = master.add(b"text")
    await cache.provide(RUN, [digest])
    measuring, go = threading.Event(), threading.Event()

    def measure(directory: Path) -> int:
        measuring.set()
        go.wait(10)
        return 1

    monkeypatch.setattr(packages, "_size", measure)
    releasing = asyncio.create_task(cache.release([]))
    await asyncio.to_thread(measuring.wait, 10)
    await cache.provide(OTHER, [digest])
    go.set()
    await releasing
    assert (root / digest / "p" / "talk").read_bytes() == b"text"


@pytest.mark.parametrize(
    "error", [Unavailable("away"), NotFound("gone"), OSError(errno.ENOSPC, "No space left on device", "archive")]
)
async def test_failed_fetch_leaves_nothing(cache: PackageCache, master: Master, root: Path, error: Exception) -> None:
    digest = master.add(b"content")
    master.refuse = error
    with pytest.raises((StartFailed, NotFound), match=r"away|gone|disk full \(archive") as raised:
        await cache.provide(RUN, [digest])
    # Unavailable would make the Master retry as if it could not reach this machine.
    assert not isinstance(raised.value, Unavailable)
    assert present(root) == set()
    master.refuse = None
    await cache.provide(RUN, [digest])
    assert present(root) == {digest}


async def test_wrong_archive_is_refused(cache: PackageCache, master: Master, root: Path) -> None:
    digest, other = master.add(b"content"), master.add(b"other")
    for content in (master.archives[other], b"garbage" * 100, b""):
        master.archives[digest] = content
        with pytest.raises((StartFailed, InvalidRequest)):
            await cache.provide(RUN, [digest])
        assert present(root) == set()


async def test_leftovers_of_a_killed_task_set_are_removed(master: Master, root: Path) -> None:
    (root / "incoming/x/tree").mkdir(parents=True)
    (root / "incoming/x/tree").chmod(0o555)
    cache = PackageCache(root, master.fetch)
    cache.open()
    assert present(root) == set()


@pytest.mark.parametrize("digest", ["", "../../etc", "A" * 64, "0" * 63])
async def test_malformed_digest_is_refused(cache: PackageCache, root: Path, digest: str) -> None:
    with pytest.raises(InvalidRequest):
        await cache.provide(RUN, [digest])
    with pytest.raises(InvalidRequest):
        package_directories(root, [digest])


@pytest.mark.parametrize("run", ["", "../x", "A" * 32])
async def test_malformed_run_is_refused(cache: PackageCache, run: str) -> None:
    with pytest.raises(RceError):
        await cache.provide(run, ["0" * 64])


def test_own_packages_precede_those_of_the_machine(root: Path) -> None:
    assert package_path(package_directories(root, ["0" * 64]), {"package_path": "/a,/b"}) == {
        "package_path": f"{root}/{'0' * 64},/a,/b"
    }
    assert package_path([], {}) == {"package_path": ""}

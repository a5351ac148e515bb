"""Files on the disk."""

from __future__ import annotations

import hashlib
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.errors import LimitExceeded, Unavailable
from rce.knowledge.contents import Contents


async def pieces(*parts: bytes) -> AsyncIterator[bytes]:
    for part in parts:
        yield part


async def test_file_is_kept_under_its_digest_until_it_is_removed(tmp_path: Path) -> None:
    contents = Contents(tmp_path, 10, 0)
    received = await contents.receive(pieces(b"a", b"b"))
    assert (received.size, received.sha256) == (2, hashlib.sha256(b"ab").hexdigest())
    assert not contents.path(received.sha256).exists()
    contents.keep(received)
    contents.discard(received)
    assert contents.path(received.sha256).read_bytes() == b"ab"
    contents.remove([received.sha256])
    assert not contents.path(received.sha256).exists()


async def test_large_file_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    contents = Contents(tmp_path, 3, 0)
    with pytest.raises(LimitExceeded):
        await contents.receive(pieces(b"ab", b"cd"))
    assert [*(tmp_path / "drafts").iterdir()] == []


async def test_space_on_the_disk_stays_free(tmp_path: Path) -> None:
    with pytest.raises(Unavailable, match="disk full"):
        await Contents(tmp_path, 3, 2**60).receive(pieces(b"a"))


async def test_what_is_not_known_is_removed_at_the_start(tmp_path: Path) -> None:
    contents = Contents(tmp_path, 10, 0)
    kept, lost = await contents.receive(pieces(b"a")), await contents.receive(pieces(b"b"))
    await contents.receive(pieces(b"c"))
    contents.keep(kept)
    contents.keep(lost)
    contents = Contents(tmp_path, 10, 0)
    assert [*(tmp_path / "drafts").iterdir()] == []
    contents.sweep({kept.sha256})
    assert (contents.path(kept.sha256).exists(), contents.path(lost.sha256).exists()) == (True, False)


async def test_file_for_which_no_room_is_left_is_refused_as_it_comes(tmp_path: Path) -> None:
    contents = Contents(tmp_path, 10, 0)

    async def filling() -> AsyncIterator[bytes]:
        yield b"a"
        contents._spare = 2**60
        yield b"b"

    with pytest.raises(Unavailable, match="disk full"):
        await contents.receive(filling())
    assert [*(tmp_path / "drafts").iterdir()] == []


async def test_kept_file_and_its_directories_are_written_to_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contents, flushed = Contents(tmp_path, 10, 0), list[Path]()
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(Path(f"/proc/self/fd/{file}").readlink()))
    received = await contents.receive(pieces(b"a"))
    contents.keep(received)
    assert flushed == [received.path, contents.path(received.sha256).parent, tmp_path]
